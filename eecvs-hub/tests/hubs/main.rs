//! Hubs: links, stores, what a fleet's programs do, and the page.

mod board;
#[allow(dead_code, reason = "the page of a report takes more of it")]
#[path = "../../../host-harness/tests/browser/mod.rs"]
mod browser;
#[path = "feed/chromium.rs"]
mod chromium;
mod feed;
mod fleet;
mod links;
mod page;
#[cfg(unix)]
mod programs;
#[cfg(target_os = "linux")]
mod strangers;
