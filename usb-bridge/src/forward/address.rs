//! Addresses that a stream goes to or comes from: `tcp://HOST:PORT`, `udp://HOST:PORT`, `unix:PATH`, `file:PATH`,
//! `-`.

use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

/// Source or destination of a stream.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum Address {
    /// A TCP connection: host and port.
    Tcp(String),
    /// UDP datagrams: host and port.
    Udp(String),
    /// A Unix domain socket in the file system.
    Unix(PathBuf),
    /// A file, which is created or replaced.
    File(PathBuf),
    /// Standard output.
    Stdout,
}

impl FromStr for Address {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let with_port = |rest: &str| {
            let port = rest
                .rsplit_once(':')
                .map(|(host, port)| (host, port.parse()));
            match port {
                Some((host, Ok(1..=u16::MAX))) if !host.is_empty() => Ok(rest.to_owned()),
                _ => Err(format!(
                    "{text}: expected HOST:PORT, with a port from 1 to 65535"
                )),
            }
        };
        let path = |rest: &str| match rest {
            "" => Err(format!("{text}: the path is missing")),
            _ => Ok(PathBuf::from(rest)),
        };
        if let Some(rest) = text.strip_prefix("tcp://") {
            with_port(rest).map(Self::Tcp)
        } else if let Some(rest) = text.strip_prefix("udp://") {
            with_port(rest).map(Self::Udp)
        } else if let Some(rest) = text.strip_prefix("unix:") {
            path(rest).map(Self::Unix)
        } else if let Some(rest) = text.strip_prefix("file:") {
            path(rest).map(Self::File)
        } else if text == "-" {
            Ok(Self::Stdout)
        } else {
            Err(format!(
                "{text}: unknown form of address: use tcp://HOST:PORT, udp://HOST:PORT, unix:PATH, \
                 file:PATH or -"
            ))
        }
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Tcp(to) => write!(f, "tcp://{to}"),
            Self::Udp(to) => write!(f, "udp://{to}"),
            Self::Unix(path) => write!(f, "unix:{}", path.display()),
            Self::File(path) => write!(f, "file:{}", path.display()),
            Self::Stdout => f.write_str("-"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_read_as_they_are_printed() {
        for text in [
            "tcp://localhost:9000",
            "tcp://[::1]:9000",
            "udp://10.0.0.2:1",
            "unix:/tmp/events",
            "file:a.eecvs",
            "-",
        ] {
            assert_eq!(text.parse::<Address>().unwrap().to_string(), text);
        }
        for text in [
            "",
            "tcp://",
            "tcp://host",
            "tcp://:80",
            "tcp://host:0",
            "tcp://host:65536",
            "udp://host:",
            "unix:",
            "file:",
            "/tmp/x",
            "http://host:80",
        ] {
            assert!(text.parse::<Address>().is_err(), "{text}");
        }
    }
}
