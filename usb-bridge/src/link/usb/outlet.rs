//! The way to a device on USB.

use std::sync::Arc;
use std::time::Duration;

use super::device::Opened;
use crate::link::{LinkError, Outlet};

/// A device that does not take bytes in this time does not take them at all.
const PATIENCE: Duration = Duration::from_secs(20);

/// Bytes of a transfer: a device that is only slow takes them in much less than [`PATIENCE`]. It has to,
/// as nobody knows how much of a transfer that was cancelled has arrived.
const TRANSFER: usize = 4096;

/// The first bulk endpoint that takes bytes, one transfer after the other.
pub struct UsbOutlet {
    opened: Arc<Opened>,
    endpoint: u8,
}

impl UsbOutlet {
    pub(super) fn new(opened: &Arc<Opened>) -> Result<Self, LinkError> {
        let endpoint = opened.bulk_out().ok_or_else(|| LinkError::Failed {
            link: opened.name.clone(),
            cause: "has no endpoint that takes bytes".to_owned(),
        })?;
        Ok(Self {
            opened: Arc::clone(opened),
            endpoint,
        })
    }
}

impl Outlet for UsbOutlet {
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        for mut left in bytes.chunks(TRANSFER) {
            while !left.is_empty() {
                let write = self.opened.handle.write_bulk(self.endpoint, left, PATIENCE);
                match write {
                    Ok(0) | Err(rusb::Error::Timeout) => {
                        return Err(LinkError::Failed {
                            link: self.opened.name.clone(),
                            cause: format!("takes no bytes since {} s", PATIENCE.as_secs()),
                        });
                    }
                    Ok(sent) => left = left.get(sent..).unwrap_or(&[]),
                    Err(error) => return Err(self.opened.error("sending", error)),
                }
            }
        }
        Ok(())
    }
}
