//! Flags that several commands share.

use std::path::PathBuf;

use clap::Args;

use crate::link::{HUB, Links};

/// The hub to connect to, and the client's keys.
#[derive(Debug, Clone, Args)]
pub struct ClientOptions {
    /// The hub: tls/HOST:PORT with --keys, else tcp/HOST:PORT; if several are given, the first that answers is used
    #[arg(long, value_name = "ENDPOINT", default_value = HUB)]
    connect: Vec<String>,

    /// The folder that eecvs-hub keys made for this client; with it, links are encrypted and both sides authenticate
    #[arg(long, value_name = "FOLDER")]
    keys: Option<PathBuf>,
}

impl ClientOptions {
    /// Returns the endpoints and keys for a session.
    #[must_use]
    pub fn links(&self) -> Links {
        Links {
            connect: self.connect.clone(),
            listen: Vec::new(),
            keys: self.keys.clone(),
        }
    }
}
