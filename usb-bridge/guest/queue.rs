//! A few bulk transfers in flight through libusb, in their order.

use std::collections::VecDeque;
use std::ffi::c_int;
use std::sync::Arc;
use std::sync::atomic::{AtomicI32, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Result, ensure};
use rusb::constants::{
    LIBUSB_TRANSFER_CANCELLED, LIBUSB_TRANSFER_COMPLETED, LIBUSB_TRANSFER_ERROR,
    LIBUSB_TRANSFER_NO_DEVICE, LIBUSB_TRANSFER_STALL,
};
use rusb::{Context, DeviceHandle, UsbContext, ffi};
use usb_bridge::link::{Link, LinkError, Loss, Received};

/// A transfer, its buffer, and whether libusb has ended it: libusb keeps the addresses of the latter.
struct Slot {
    transfer: *mut ffi::libusb_transfer,
    buffer: Vec<u8>,
    done: Box<AtomicI32>,
}

/// The stream of one bulk endpoint.
pub struct Queue {
    handle: Arc<DeviceHandle<Context>>,
    endpoint: u8,
    in_flight: VecDeque<Slot>,
    idle: Vec<Slot>,
}

// SAFETY: libusb's transfers may be used from any thread, one at a time, and the slots are not shared.
unsafe impl Send for Queue {}

impl Queue {
    /// Puts `count` transfers of `bytes` bytes in flight.
    pub fn new(
        handle: Arc<DeviceHandle<Context>>,
        endpoint: u8,
        count: usize,
        bytes: usize,
    ) -> Result<Self> {
        let mut queue = Self {
            handle,
            endpoint,
            in_flight: VecDeque::new(),
            idle: Vec::new(),
        };
        for _ in 0..count {
            // SAFETY: allocates; the result is checked.
            let transfer = unsafe { ffi::libusb_alloc_transfer(0) };
            ensure!(!transfer.is_null(), "no memory for a transfer");
            queue.idle.push(Slot {
                transfer,
                buffer: vec![0; bytes],
                done: Box::new(AtomicI32::new(0)),
            });
        }
        queue.submit().map_err(anyhow::Error::from)?;
        Ok(queue)
    }

    /// Gives every idle transfer to libusb.
    fn submit(&mut self) -> Result<(), LinkError> {
        while let Some(mut slot) = self.idle.pop() {
            slot.done.store(0, Ordering::Relaxed);
            // SAFETY: the transfer is libusb's own and idle; the buffer and the flag keep their places
            // until the transfer has ended, which `drop` waits for.
            let result = unsafe {
                ffi::libusb_fill_bulk_transfer(
                    slot.transfer,
                    self.handle.as_raw(),
                    self.endpoint,
                    slot.buffer.as_mut_ptr(),
                    slot.buffer.len() as c_int,
                    ended,
                    std::ptr::from_ref(&*slot.done).cast_mut().cast(),
                    0,
                );
                ffi::libusb_submit_transfer(slot.transfer)
            };
            if result != 0 {
                self.idle.push(slot);
                return Err(self.unplugged());
            }
            self.in_flight.push_back(slot);
        }
        Ok(())
    }

    fn unplugged(&self) -> LinkError {
        LinkError::Unplugged {
            link: self.name().to_owned(),
        }
    }

    /// Lets libusb work until the front transfer has ended, at most for `timeout`.
    fn wait(&mut self, timeout: Duration) -> bool {
        let until = Instant::now() + timeout;
        let Some(front) = self.in_flight.front() else {
            return false;
        };
        while front.done.load(Ordering::Acquire) == 0 {
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return false;
            }
            // A `struct timeval`, as 64-bit Linux has it.
            let time = [left.as_secs() as i64, i64::from(left.subsec_micros())];
            // SAFETY: the context outlives the handle; the time is as C has it; the flag is an
            // integer that `ended` writes.
            unsafe {
                ffi::libusb_handle_events_timeout_completed(
                    self.handle.context().as_raw(),
                    time.as_ptr().cast(),
                    front.done.as_ptr(),
                );
            }
        }
        true
    }
}

/// A transfer has ended: its owner finds the flag set.
extern "system" fn ended(transfer: *mut ffi::libusb_transfer) {
    // SAFETY: libusb hands over the transfer that was submitted, whose data is the flag in its slot.
    let done = unsafe { &*(*transfer).user_data.cast::<AtomicI32>() };
    done.store(1, Ordering::Release);
}

impl Link for Queue {
    fn name(&self) -> &str {
        "usb"
    }

    fn receive(&mut self, timeout: Duration) -> Result<Received<'_>, LinkError> {
        self.submit()?;
        if !self.wait(timeout) {
            return Ok(Received::Nothing);
        }
        let Some(slot) = self.in_flight.pop_front() else {
            return Ok(Received::Nothing);
        };
        // SAFETY: the transfer has ended: libusb does not write it any more.
        let (status, length) = unsafe {
            (
                (*slot.transfer).status,
                (*slot.transfer).actual_length as usize,
            )
        };
        self.idle.push(slot);
        match status {
            LIBUSB_TRANSFER_COMPLETED => {
                let bytes = &self.idle[self.idle.len() - 1].buffer[..length];
                let at = Instant::now();
                Ok(Received::Bytes { bytes, at })
            }
            LIBUSB_TRANSFER_STALL => {
                // Those behind it end in the same way; only then the halt may end.
                while self.wait(Duration::from_secs(2)) {
                    self.idle.extend(self.in_flight.pop_front());
                }
                let endpoint = self.endpoint;
                let link = self.name().to_owned();
                self.handle
                    .clear_halt(endpoint)
                    .map_err(|_| LinkError::Stalled { link, endpoint })?;
                Ok(Received::Lost {
                    bytes: Some(0),
                    cause: Loss::Stalled,
                })
            }
            // Removal shows as either.
            LIBUSB_TRANSFER_NO_DEVICE | LIBUSB_TRANSFER_ERROR | LIBUSB_TRANSFER_CANCELLED => {
                Err(self.unplugged())
            }
            other => Err(LinkError::Failed {
                link: self.name().to_owned(),
                cause: format!("transfer status {other}"),
            }),
        }
    }

    fn send(&mut self, _bytes: &[u8]) -> Result<(), LinkError> {
        Ok(())
    }
}

impl Drop for Queue {
    fn drop(&mut self) {
        for slot in &self.in_flight {
            // SAFETY: the transfer is in flight, or has ended, which libusb reports.
            unsafe { ffi::libusb_cancel_transfer(slot.transfer) };
        }
        while !self.in_flight.is_empty() {
            if !self.wait(Duration::from_secs(5)) {
                // libusb still has the rest: it must not be freed.
                self.in_flight.drain(..).for_each(std::mem::forget);
                break;
            }
            self.idle.extend(self.in_flight.pop_front());
        }
        for slot in &self.idle {
            // SAFETY: the transfer has ended and is not used again.
            unsafe { ffi::libusb_free_transfer(slot.transfer) };
        }
    }
}
