//! The sending side of a USB device.

use std::sync::Arc;
use std::time::Duration;

use super::device::Opened;
use crate::link::{LinkError, Outlet};

/// A device that accepts no bytes for this long has failed.
const PATIENCE: Duration = Duration::from_secs(20);

/// Bytes per transfer. A device that is merely slow must accept them well within [`PATIENCE`], because it is
/// unknown how much of a cancelled transfer has arrived.
const TRANSFER: usize = 4096;

/// Sends to the first bulk OUT endpoint of the interface, one transfer at a time.
pub struct UsbOutlet {
    opened: Arc<Opened>,
    endpoint: u8,
}

impl UsbOutlet {
    pub(super) fn new(opened: &Arc<Opened>) -> Result<Self, LinkError> {
        let endpoint = opened.bulk_out().ok_or_else(|| LinkError::Failed {
            link: opened.name.clone(),
            cause: "has no endpoint that accepts bytes".to_owned(),
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
                            cause: format!("has accepted no bytes for {} s", PATIENCE.as_secs()),
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
