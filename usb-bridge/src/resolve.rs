//! Looks up the addresses of a host's name without being held up by a resolver that does not answer.

use std::io::{self, ErrorKind};
use std::net::{SocketAddr, ToSocketAddrs};
use std::time::{Duration, Instant};

use crate::stop::wait_for;

/// Longest wait for the addresses of a name.
pub const DEADLINE: Duration = Duration::from_secs(10);

/// Returns the addresses of `HOST:PORT`, at least one. A name is looked up while `goes_on` returns true, for at most
/// [`DEADLINE`].
///
/// # Errors
/// The name has no address, or the resolver did not answer; `Interrupted` if `goes_on` returned false.
pub fn addresses(of: &str, goes_on: &dyn Fn() -> bool) -> io::Result<Vec<SocketAddr>> {
    if let Ok(address) = of.parse() {
        return Ok(vec![address]);
    }
    let name = of.to_owned();
    let look_up = move || Ok(name.to_socket_addrs()?.collect());
    let found: Vec<SocketAddr> = wait(look_up, DEADLINE, goes_on)?;
    match found.is_empty() {
        true => Err(io::Error::new(
            ErrorKind::NotFound,
            "the host name has no address",
        )),
        false => Ok(found),
    }
}

/// Waits for a look-up while `goes_on` returns true, until the deadline.
fn wait<T: Send + 'static>(
    look_up: impl FnOnce() -> io::Result<T> + Send + 'static,
    deadline: Duration,
    goes_on: &dyn Fn() -> bool,
) -> io::Result<T> {
    let since = Instant::now();
    let found = wait_for(look_up, &|| goes_on() && since.elapsed() < deadline)?;
    found.unwrap_or_else(|| {
        let (kind, why) = match goes_on() {
            true => (ErrorKind::TimedOut, "the host name is not resolved in time"),
            false => (
                ErrorKind::Interrupted,
                "stopped while the host name was looked up",
            ),
        };
        Err(io::Error::new(kind, why))
    })
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::{Receiver, channel};

    use super::*;

    fn silent(hangs: Receiver<()>) -> impl FnOnce() -> io::Result<()> + Send + 'static {
        move || {
            let _ = hangs.recv();
            Ok(())
        }
    }

    #[test]
    fn a_resolver_that_does_not_answer_is_left_at_once_and_in_time() {
        // The resolver answers when these are dropped, after the test.
        let ((_held, hangs), (_kept, stays)) = (channel(), channel());
        let error = wait(silent(hangs), Duration::from_secs(600), &|| false).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Interrupted);
        let error = wait(silent(stays), Duration::ZERO, &|| true).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::TimedOut);
    }

    #[test]
    fn numbers_and_names_are_found() {
        let found = addresses("[::1]:9", &|| false).unwrap();
        assert_eq!(found, [SocketAddr::from(([0, 0, 0, 0, 0, 0, 0, 1], 9))]);
        let found = addresses("localhost:9", &|| true).unwrap();
        assert!(found.iter().all(|address| address.ip().is_loopback()));
        assert!(addresses("no host:9", &|| true).is_err());
    }
}
