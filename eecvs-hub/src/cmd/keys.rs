//! `eecvs-hub keys`: adds members to a fleet, and makes their keys.

use std::path::PathBuf;

use anyhow::Result;
use clap::{Args, Subcommand};
use eecvs_cli::output::print;

use crate::access::Role;
use crate::certificate::Authority;
use crate::key::{Name, names};

/// Make the keys of a hub, a sensor or a receiver, and add it to the list of who may do what; if the folder has no
/// authority yet, one is created, whose own key no other machine needs
#[derive(Debug, Clone, Args)]
pub struct Keys {
    /// The folder that holds the authority, the list access.toml, and a folder with each member's keys
    #[arg(value_name = "FOLDER")]
    folder: PathBuf,

    /// Days for which certificates are valid
    #[arg(long, value_name = "N", default_value_t = 825, global = true,
          value_parser = clap::value_parser!(u32).range(1..=36_500))]
    days: u32,

    #[command(subcommand)]
    who: Who,
}

#[derive(Debug, Clone, Subcommand)]
enum Who {
    /// A hub, with the names and addresses under which it is reached
    Hub {
        /// Name of the hub
        name: Name,

        /// Host names and addresses that sensors, receivers and other hubs connect to
        #[arg(long, value_name = "HOST", default_values = ["localhost", "127.0.0.1"])]
        host: Vec<String>,
    },
    /// A sensor, which may publish only under its own name
    Sensor {
        /// Name of the sensor: door, or hall-1/door
        name: Name,
    },
    /// A receiver, with the sensors that it may receive from
    Receiver {
        /// Name of the receiver
        name: Name,

        /// Sensors: hall-1/door for one, hall-1/** for all in a hall, ** for all
        #[arg(long, value_name = "NAMES", required = true,
              value_parser = |text: &str| names(text))]
        hears: Vec<String>,
    },
}

impl Keys {
    /// Makes the keys, and lists their owner.
    ///
    /// # Errors
    /// The folder cannot be written, or the member has keys already.
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
