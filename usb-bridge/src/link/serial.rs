//! A serial port: the MCU as a CDC-ACM device, or a UART on an adapter.

use std::io::{self, Read};
use std::time::{Duration, Instant};

use serialport::{ErrorKind, FlowControl, SerialPort};

use super::{Link, LinkError, Outlet, Received};

/// Default baud rate. A CDC-ACM device accepts any rate and runs at the speed of USB.
pub const BAUD: u32 = 115_200;

/// Bytes per read: several times what a port buffers for its reader.
const BUFFER: usize = 64 * 1024;

/// A port that accepts no bytes for this long has failed.
const PATIENCE: Duration = Duration::from_secs(5);

/// A serial port with 8 data bits and no parity. Creating an [`Outlet`] turns on hardware flow control.
pub struct SerialLink {
    port: Box<dyn SerialPort>,
    name: String,
    buffer: Vec<u8>,
}

impl SerialLink {
    /// Opens a port by its name, such as `/dev/ttyACM0` or `COM3`.
    ///
    /// # Errors
    /// The port does not exist, is in use, or may not be opened.
    pub fn open(path: &str, baud: u32) -> Result<Self, LinkError> {
        let port = serialport::new(path, baud)
            .timeout(PATIENCE)
            .open()
            .map_err(|error| opening(path, &error))?;
        Ok(Self {
            port,
            name: path.to_owned(),
            buffer: vec![0; BUFFER],
        })
    }

    fn failed(&self, error: &io::Error) -> LinkError {
        failed(&self.name, error)
    }
}

fn opening(path: &str, error: &serialport::Error) -> LinkError {
    let link = path.to_owned();
    match error.kind {
        ErrorKind::Io(io::ErrorKind::PermissionDenied) => LinkError::Permission {
            link,
            remedy:
                "join the group that may use serial ports, `sudo usermod -aG dialout $USER`, and log in again"
                    .to_owned(),
        },
        // The library also reports a port locked by another program this way.
        ErrorKind::NoDevice if error.description.contains("busy") => LinkError::Busy { link },
        _ => LinkError::Unreachable {
            link,
            cause: error.description.clone(),
        },
    }
}

fn failed(name: &str, error: &io::Error) -> LinkError {
    let link = name.to_owned();
    /// Error of Linux and macOS for a port whose device has gone.
    const EIO: i32 = 5;
    match error.kind() {
        io::ErrorKind::BrokenPipe | io::ErrorKind::NotConnected | io::ErrorKind::NotFound => {
            LinkError::Unplugged { link }
        }
        _ if error.raw_os_error() == Some(EIO) => LinkError::Unplugged { link },
        io::ErrorKind::TimedOut => LinkError::Failed {
            link,
            cause: format!("has accepted no bytes for {} s", PATIENCE.as_secs()),
        },
        _ => LinkError::Failed {
            link,
            cause: error.to_string(),
        },
    }
}

impl Link for SerialLink {
    fn name(&self) -> &str {
        &self.name
    }

    fn receive(&mut self, timeout: Duration) -> Result<Received<'_>, LinkError> {
        let set = self.port.set_timeout(timeout);
        set.map_err(|error| self.failed(&error.into()))?;
        match self.port.read(&mut self.buffer) {
            // A read of zero bytes means that the device has gone.
            Ok(0) => Err(LinkError::Unplugged {
                link: self.name.clone(),
            }),
            Ok(length) => Ok(Received::Bytes {
                bytes: &self.buffer[..length],
                at: Instant::now(),
            }),
            Err(error) => match error.kind() {
                io::ErrorKind::TimedOut
                | io::ErrorKind::WouldBlock
                | io::ErrorKind::Interrupted => Ok(Received::Nothing),
                _ => Err(self.failed(&error)),
            },
        }
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        send(self.port.as_mut(), &self.name, bytes)
    }

    /// Turns on RTS/CTS, so that a busy UART can hold the sender back. A CDC-ACM device has no such lines and needs
    /// none.
    fn outlet(&self) -> Result<Box<dyn Outlet>, LinkError> {
        let port = self.port.try_clone().and_then(|mut port| {
            port.set_flow_control(FlowControl::Hardware)?;
            Ok(port)
        });
        Ok(Box::new(SerialOutlet {
            port: port.map_err(|error| self.failed(&error.into()))?,
            name: self.name.clone(),
        }))
    }
}

/// The sending side of a serial port.
struct SerialOutlet {
    port: Box<dyn SerialPort>,
    name: String,
}

impl Outlet for SerialOutlet {
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        send(self.port.as_mut(), &self.name, bytes)
    }
}

fn send(port: &mut dyn SerialPort, name: &str, bytes: &[u8]) -> Result<(), LinkError> {
    port.set_timeout(PATIENCE)
        .map_err(io::Error::from)
        .and_then(|()| port.write_all(bytes))
        .map_err(|error| failed(name, &error))
}

#[cfg(all(test, unix))]
mod tests {
    use std::io::Write;

    use super::*;

    fn pair() -> (SerialLink, serialport::TTYPort) {
        let (ours, theirs) = serialport::TTYPort::pair().unwrap();
        let link = SerialLink {
            port: Box::new(ours),
            name: "pty".to_owned(),
            buffer: vec![0; BUFFER],
        };
        (link, theirs)
    }

    #[test]
    fn bytes_go_both_ways_and_a_pause_is_nothing() {
        let (mut link, mut device) = pair();
        assert_eq!(
            link.receive(Duration::from_millis(5)).unwrap(),
            Received::Nothing
        );
        link.send(b"E+\n").unwrap();
        device.set_timeout(Duration::from_secs(1)).unwrap();
        let mut told = [0; 3];
        device.read_exact(&mut told).unwrap();
        assert_eq!(&told, b"E+\n");
        device.write_all(&[0, 255, 10, 13, 3]).unwrap();
        let mut got = Vec::new();
        while got.len() < 5 {
            if let Received::Bytes { bytes, .. } = link.receive(Duration::from_secs(1)).unwrap() {
                got.extend_from_slice(bytes);
            }
        }
        assert_eq!(got, [0, 255, 10, 13, 3]);
    }

    #[test]
    fn a_port_whose_device_has_gone_is_unplugged() {
        let (mut link, device) = pair();
        drop(device);
        let error = link.receive(Duration::from_millis(100)).unwrap_err();
        assert!(matches!(error, LinkError::Unplugged { .. }), "{error}");
    }

    #[test]
    fn a_port_that_is_not_there_is_told_in_one_line() {
        let error = SerialLink::open("/dev/no_such_port", BAUD).err().unwrap();
        let told = error.to_string();
        assert!(
            told.starts_with("/dev/no_such_port: cannot be reached: "),
            "{told}"
        );
        let busy = serialport::Error::new(ErrorKind::NoDevice, "Device or resource busy");
        assert!(matches!(opening("p", &busy), LinkError::Busy { .. }));
        let denied = ErrorKind::Io(io::ErrorKind::PermissionDenied);
        let told = opening("p", &serialport::Error::new(denied, "")).to_string();
        assert!(told.contains("dialout"), "{told}");
    }
}
