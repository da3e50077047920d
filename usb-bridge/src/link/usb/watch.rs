//! Watches for USB devices that arrive or leave.

use std::collections::VecDeque;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread;
use std::time::{Duration, Instant};

use rusb::constants::LIBUSB_CAP_HAS_HOTPLUG;
use rusb::{Context, Hotplug, HotplugBuilder, Registration, UsbContext};

use super::bus::{Attached, Bus};
use super::choose::choose;
use crate::link::{LinkError, until};

/// Period at which devices are listed where libusb does not report changes.
const POLL: Duration = Duration::from_millis(200);

/// Time after arrival within which a device may lack permission: udev sets it after the arrival.
const SETTLING: Duration = Duration::from_secs(2);

/// A device that arrived or left.
#[derive(Clone)]
pub enum Change {
    /// A device is attached; devices that were there from the beginning are reported as well.
    Arrived(Box<Attached>),
    /// A device has gone.
    Left {
        /// Its port, as returned by [`Attached::id`].
        id: String,
    },
}

/// Reports every device that arrives or leaves, whether its model is known or not.
pub struct Watch {
    source: Source,
}

enum Source {
    Told {
        // Dropped first, because dropping it ends the callbacks.
        _registration: Registration<Context>,
        context: Context,
        changes: Receiver<(bool, rusb::Device<Context>)>,
    },
    Polled {
        known: Vec<((u8, u8), String)>,
        changes: VecDeque<Change>,
        next: Instant,
    },
}

struct Callbacks(Sender<(bool, rusb::Device<Context>)>);

impl Hotplug<Context> for Callbacks {
    // A hotplug callback must not call into libusb.
    fn device_arrived(&mut self, device: rusb::Device<Context>) {
        let _ = self.0.send((true, device));
    }

    fn device_left(&mut self, device: rusb::Device<Context>) {
        let _ = self.0.send((false, device));
    }
}

impl Watch {
    /// Begins to watch; devices that are attached already are reported as arrivals.
    ///
    /// # Errors
    /// Those of [`Bus::new`].
    pub fn new() -> Result<Self, LinkError> {
        let failed = |error| LinkError::Failed {
            link: "usb".to_owned(),
            cause: format!("cannot watch for arriving devices: {error}"),
        };
        // Without a host controller there is no context; a controller may still be plugged in later.
        let Some(context) = Context::new().ok().filter(|_| is_told()) else {
            return Ok(Self::polling());
        };
        let (sender, changes) = channel();
        let registration = HotplugBuilder::new()
            .enumerate(true)
            .register(&context, Box::new(Callbacks(sender)))
            .map_err(failed)?;
        Ok(Self {
            source: Source::Told {
                _registration: registration,
                context,
                changes,
            },
        })
    }

    /// Watches by listing the devices periodically, for systems where libusb reports no changes.
    #[must_use]
    pub fn polling() -> Self {
        Self {
            source: Source::Polled {
                known: Vec::new(),
                changes: VecDeque::new(),
                next: Instant::now(),
            },
        }
    }

    /// Returns whether the system reports changes; otherwise the devices are listed periodically.
    #[must_use]
    pub const fn is_told(&self) -> bool {
        matches!(self.source, Source::Told { .. })
    }

    /// Returns the next change, or `None` if there is none within `timeout`.
    ///
    /// # Errors
    /// The devices cannot be listed.
    pub fn next(&mut self, timeout: Duration) -> Result<Option<Change>, LinkError> {
        let deadline = until(timeout);
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            match &mut self.source {
                Source::Told {
                    context, changes, ..
                } => {
                    while let Ok((arrived, device)) = changes.try_recv() {
                        let Some(attached) = Attached::of(device) else {
                            continue;
                        };
                        return Ok(Some(if arrived {
                            Change::Arrived(Box::new(attached))
                        } else {
                            Change::Left { id: attached.id() }
                        }));
                    }
                    if left.is_zero() {
                        return Ok(None);
                    }
                    if context.handle_events(Some(left.min(POLL))).is_err() {
                        thread::sleep(Duration::from_millis(1));
                    }
                }
                Source::Polled {
                    known,
                    changes,
                    next,
                } => {
                    if let Some(change) = changes.pop_front() {
                        return Ok(Some(change));
                    }
                    let now = Instant::now();
                    if *next <= now {
                        *next = now + POLL;
                        list(known, changes)?;
                    } else if left.is_zero() {
                        return Ok(None);
                    } else {
                        thread::sleep(left.min(*next - now));
                    }
                }
            }
        }
    }
}

/// Returns whether libusb reports changes on this system. rusb's own query creates a global context, and panics on
/// a machine without USB.
#[expect(unsafe_code, reason = "see above")]
fn is_told() -> bool {
    // SAFETY: this queries a property of the library and needs no context.
    unsafe { rusb::ffi::libusb_has_capability(LIBUSB_CAP_HAS_HOTPLUG) != 0 }
}

/// Lists the devices and compares them with `known`. A device at another address counts as another device.
fn list(
    known: &mut Vec<((u8, u8), String)>,
    changes: &mut VecDeque<Change>,
) -> Result<(), LinkError> {
    // A new context each time: without change reports, a context keeps the list from its creation.
    let present = Bus::new()?.all()?;
    let key = |one: &Attached| (one.bus, one.address);
    known.retain(|(at, id)| {
        let stays = present.iter().any(|one| key(one) == *at);
        if !stays {
            changes.push_back(Change::Left { id: id.clone() });
        }
        stays
    });
    for one in present {
        if known.iter().all(|(at, _)| *at != key(&one)) {
            known.push((key(&one), one.id()));
            changes.push_back(Change::Arrived(Box::new(one)));
        }
    }
    Ok(())
}

/// Waits for the known device that `wanted` names, or for the only one, until it is attached and may be opened.
/// Returns `None` once `given_up` returns true.
///
/// # Errors
/// Several devices fit, or the device may not be opened even a while after its arrival.
pub fn wait_for(
    wanted: Option<&str>,
    given_up: &dyn Fn() -> bool,
) -> Result<Option<Attached>, LinkError> {
    let mut watch = Watch::new()?;
    let mut forbidden_since: Option<Instant> = None;
    while !given_up() {
        // The devices are listed even without a change: a change of permission is not reported.
        while watch.next(Duration::ZERO)?.is_some() {}
        let mut devices = Bus::new()?.devices()?;
        let candidates: Vec<_> = devices.iter().map(Attached::candidate).collect();
        let Some(index) = choose(&candidates, wanted)? else {
            forbidden_since = None;
            watch.next(POLL)?;
            continue;
        };
        let attached = devices.swap_remove(index);
        let interface = attached
            .model
            .map_or(0, |model| model.transfers().interface);
        match attached.open(interface).map(drop) {
            Ok(()) => return Ok(Some(attached)),
            Err(error @ LinkError::Permission { .. }) => {
                let since = *forbidden_since.get_or_insert_with(Instant::now);
                if since.elapsed() > SETTLING {
                    return Err(error);
                }
            }
            // The device left again.
            Err(LinkError::Unplugged { .. }) => {}
            Err(error) => return Err(error),
        }
        watch.next(POLL)?;
    }
    Ok(None)
}
