//! `eecvs-hub keys`: who belongs to a fleet, and its keys.

use std::path::PathBuf;

use anyhow::Result;
use clap::{Args, Subcommand};
use eecvs_cli::output::print;

use crate::access::Role;
use crate::certificate::Authority;
use crate::key::{Name, names};

/// Make the keys of a hub, a sensor or a receiver, and list who may what; the folder gets an authority first, whose own
/// key no other machine needs
#[derive(Debug, Clone, Args)]
pub struct Keys {
    /// The folder of the authority, of the list access.toml, and of a folder for each that has keys
    #[arg(value_name = "FOLDER")]
    folder: PathBuf,

    /// Days that certificates are good for
    #[arg(long, value_name = "N", default_value_t = 825, global = true,
          value_parser = clap::value_parser!(u32).range(1..=36_500))]
    days: u32,

    #[command(subcommand)]
    who: Who,
}

#[derive(Debug, Clone, Subcommand)]
enum Who {
    /// A hub, and under which names and addresses it is reached
    Hub {
        /// What it is called
        name: Name,

        /// Host names and addresses that sensors, receivers and other hubs connect to
        #[arg(long, value_name = "HOST", default_values = ["localhost", "127.0.0.1"])]
        host: Vec<String>,
    },
    /// A sensor, which may speak under its own name alone
    Sensor {
        /// What it is called: door, or hall-1/door
        name: Name,
    },
    /// A receiver, and which sensors it may hear
    Receiver {
        /// What it is called
        name: Name,

        /// Sensors: hall-1/door, all of a hall by hall-1/**, all by **
        #[arg(long, value_name = "NAMES", required = true,
              value_parser = |text: &str| names(text))]
        hears: Vec<String>,
    },
}

impl Keys {
    /// Makes and lists them.
    ///
    /// # Errors
    /// The folder cannot be written, or has such keys already.
    pub fn run(self) -> Result<()> {
        let authority = Authority::open(&self.folder, self.days)?;
        let (role, hosts, hears) = match self.who {
            Who::Hub { name, host } => (Role::Hub(name.into()), host, Vec::new()),
            Who::Sensor { name } => (Role::Sensor(name), Vec::new(), Vec::new()),
            Who::Receiver { name, hears } => (Role::Receiver(name.into()), Vec::new(), hears),
        };
        let folder = authority.sign(&role, &hosts, &hears, self.days)?;
        print(&format!(
            "{}: ca.pem, cert.pem, key.pem of {}\n",
            folder.display(),
            role.common_name()
        ))
    }
}
