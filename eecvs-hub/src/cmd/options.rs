//! Flags that several commands share.

use std::path::PathBuf;

use clap::Args;

use crate::link::{HUB, Links};

/// Where a hub is, and who this is.
#[derive(Debug, Clone, Args)]
pub struct ClientOptions {
    /// The hub: tls/HOST:PORT with --keys, else tcp/HOST:PORT; of several, the first that answers
    #[arg(long, value_name = "ENDPOINT", default_value = HUB)]
    connect: Vec<String>,

    /// The folder that eecvs-hub keys has made for this client: links are encrypted, and both sides show who they are
    #[arg(long, value_name = "FOLDER")]
    keys: Option<PathBuf>,
}

impl ClientOptions {
    /// As sessions take it.
    #[must_use]
    pub fn links(&self) -> Links {
        Links {
            connect: self.connect.clone(),
            listen: Vec::new(),
            keys: self.keys.clone(),
        }
    }
}
