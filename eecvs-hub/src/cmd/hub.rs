//! `eecvs-hub hub`: routes between sensors and receivers, and shows the sensors on a page.

use std::collections::BTreeMap;
use std::net::TcpListener;
use std::path::PathBuf;
use std::thread;
use std::time::Duration;

use anyhow::{Context as _, Result, bail, ensure};
use clap::Args;
use eecvs_cli::say;
use usb_bridge::resolve::addresses;
use usb_bridge::stop::{Stop, wait_for};

use crate::access::{Access, FILE};
use crate::hub;
use crate::key::names;
use crate::link::{HUB, Links};

/// Route between sensors and receivers, and show each sensor's rate, losses, delay and picture on a page
#[derive(Debug, Clone, Args)]
pub struct Hub {
    /// Name of the hub, shown on its page
    #[arg(long, value_name = "NAME", default_value = "hub")]
    name: String,

    /// Endpoint for sensors, receivers and other hubs: tls/ADDRESS:PORT with --keys; without, tcp/127.0.0.1:PORT,
    /// or with --anyone another address [default: tcp/127.0.0.1:7447, with --keys tls/[::]:7447]
    #[arg(long, value_name = "ENDPOINT")]
    listen: Vec<String>,

    /// Other hubs to connect to
    #[arg(long, value_name = "ENDPOINT")]
    connect: Vec<String>,

    /// The folder that eecvs-hub keys made for this hub; with it, links are encrypted and both sides authenticate
    #[arg(long, value_name = "FOLDER")]
    keys: Option<PathBuf>,

    /// The folder that holds access.toml, which lists who may do what [default: the parent folder of --keys]
    #[arg(long, value_name = "FOLDER", requires = "keys")]
    access: Option<PathBuf>,

    /// Without --keys: listen on any address, and admit anyone
    #[arg(long, conflicts_with = "keys")]
    anyone: bool,

    /// Address of the page; anyone who can reach it can see the page
    #[arg(long, value_name = "ADDRESS:PORT", default_value = "127.0.0.1:8447")]
    page: String,

    /// Do not serve a page
    #[arg(long, conflicts_with = "page")]
    no_page: bool,

    /// Sensors on the page: names, or hall-1/** for all in a hall
    #[arg(long, value_name = "NAMES", default_value = "**", value_parser = |text: &str| names(text))]
    watch: String,

    /// Only route: watch no sensors, and send them no budgets
    #[arg(long)]
    no_watch: bool,

    /// Maximum bytes per second of each sensor with one of these names; the first match applies
    #[arg(long, value_name = "NAMES=B", value_parser = budget)]
    budget: Vec<(String, u32)>,

    /// Maximum bytes per second of all watched sensors together: shared evenly among those that need it
    #[arg(long, value_name = "B", value_parser = clap::value_parser!(u32).range(1..))]
    total_budget: Option<u32>,
}

fn budget(text: &str) -> Result<(String, u32), String> {
    let (of, bytes) = text
        .split_once('=')
        .ok_or("expected NAMES=B, such as hall-1/**=1000000")?;
    let bytes: u32 = bytes
        .parse()
        .map_err(|_| format!("{bytes:?}: expected a number of bytes per second"))?;
    if bytes == 0 {
        return Err(
            "a budget cannot be 0: to shut a sensor out, remove it from access.toml".to_owned(),
        );
    }
    let names = names(of).map_err(|error| error.to_string())?;
    Ok((names, bytes))
}

/// Interval at which the hub checks its connections.
const LOOK: Duration = Duration::from_millis(200);

impl Hub {
    /// Routes until a stop is requested.
    ///
    /// # Errors
    /// The keys or the access list are invalid, or an address cannot be listened on.
    pub fn run(self, stop: &Stop) -> Result<()> {
        let listen = match (self.listen.is_empty(), &self.keys) {
            (false, _) => self.listen.clone(),
            (true, None) => vec![HUB.to_owned()],
            (true, Some(_)) => vec!["tls/[::]:7447".to_owned()],
        };
        if self.keys.is_none() && !self.anyone {
            for endpoint in &listen {
                let is_own = ["tcp/127.", "tcp/localhost:", "tcp/[::1]:"];
                ensure!(
                    is_own.iter().any(|own| endpoint.starts_with(own)),
                    "{endpoint}: without --keys anyone may send and receive there: give --keys or --anyone"
                );
            }
        }
        let access = match &self.keys {
            None => None,
            Some(keys) => Some(self.access(keys)?),
        };
        let page = match self.no_page {
            true => None,
            false => {
                let at = addresses(&self.page, &|| !stop.is_asked());
                let bound = at.and_then(|at| TcpListener::bind(at.as_slice()));
                Some(bound.with_context(|| {
                    format!(
                        "--page {}: cannot listen there: give another address, or --no-page",
                        self.page
                    )
                })?)
            }
        };
        let address = page.as_ref().and_then(|page| page.local_addr().ok());
        let links = Links {
            connect: self.connect.clone(),
            listen: listen.clone(),
            keys: self.keys.clone(),
        };
        let options = hub::Options {
            name: self.name.clone(),
            watch: (!self.no_watch).then(|| self.watch.clone()),
            budgets: self.budget.clone(),
            total: self.total_budget,
            access,
        };
        // A name to listen at may take long to look up.
        let start = move || hub::Hub::start(options, &links, page);
        let Some(hub) = wait_for(start, &|| !stop.is_asked())? else {
            bail!("stopped before the hub listened at {}", listen.join(", "));
        };
        let hub = hub?;
        say!("eecvs-hub: {} listens on {}", self.name, listen.join(", "));
        if let Some(address) = address {
            say!("eecvs-hub: its page is http://{address}/");
        }
        let mut told = 0;
        let mut shared = BTreeMap::new();
        while !stop.is_asked() && !hub.has_ended() {
            let routers = hub.routers();
            if routers != told {
                say!("eecvs-hub: {routers} other hubs are connected");
                told = routers;
            }
            for (name, sensors) in hub.board().shared_names() {
                if shared.insert(name.clone(), sensors) != Some(sensors) {
                    say!(
                        "eecvs-hub: {name}: {sensors} sensors send under this name at once: give each a name of its own"
                    );
                }
            }
            thread::sleep(LOOK);
        }
        hub.finish_soon()
    }

    fn access(&self, keys: &std::path::Path) -> Result<Access> {
        let folder = match &self.access {
            Some(folder) => folder.clone(),
            None => keys.join(".."),
        };
        let path = folder.join(FILE);
        ensure!(
            path.is_file(),
            "{}: no such file: eecvs-hub keys writes it; give its folder with --access",
            path.display()
        );
        Access::read(&folder)
    }
}
