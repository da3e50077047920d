//! A ring of bulk transfers in flight: the only file that hands memory to libusb.
//!
//! Each transfer is in one of three states:
//!
//! ```text
//! Ours      ours: its buffer may be read, and it may be submitted or freed
//! InFlight  owned by libusb and the kernel, from its submission until its callback has run
//! Done      ours again, with its result
//! ```
//!
//! Only [`Ring::submit`] makes a transfer InFlight, and only the transfer's callback makes it Done. Buffers are read
//! and memory is freed only in the states Ours and Done; a transfer that never comes back is leaked with everything
//! it points to.
//!
//! Callbacks run on a thread of the ring, or on a thread that waits for a control request. The ring's thread exists
//! for the arrival times: they are taken when a transfer ends, not when the receiver asks for it, so that the
//! device's clock can be related to the host's even while the receiver is busy.
#![expect(unsafe_code, reason = "rusb has no asynchronous transfers")]

use std::ffi::c_int;
use std::ptr::{self, NonNull};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use rusb::constants::{
    LIBUSB_ERROR_BUSY, LIBUSB_ERROR_INVALID_PARAM, LIBUSB_ERROR_IO, LIBUSB_ERROR_NO_DEVICE,
    LIBUSB_ERROR_NO_MEM, LIBUSB_ERROR_NOT_SUPPORTED, LIBUSB_TRANSFER_CANCELLED,
    LIBUSB_TRANSFER_COMPLETED, LIBUSB_TRANSFER_NO_DEVICE, LIBUSB_TRANSFER_OVERFLOW,
    LIBUSB_TRANSFER_STALL, LIBUSB_TRANSFER_TIMED_OUT,
};
use rusb::ffi::{
    libusb_alloc_transfer, libusb_cancel_transfer, libusb_fill_bulk_transfer, libusb_free_transfer,
    libusb_interrupt_event_handler, libusb_submit_transfer, libusb_transfer,
};
use rusb::{Error, UsbContext};

use super::device::Opened;

/// How a transfer ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Status {
    /// It is full, or the device ended it with a short packet.
    Complete,
    /// It was cancelled before it was full.
    Cancelled,
    /// The endpoint halted.
    Stalled,
    /// The device sent more than the transfer had room for.
    Overflow,
    /// The device has gone.
    NoDevice,
    /// An error on the wire.
    Failed,
}

/// The result of a transfer that ended.
#[derive(Debug, Clone, Copy)]
pub(super) struct Completion {
    pub(super) status: Status,
    /// Bytes received, whatever the status.
    pub(super) length: usize,
    pub(super) at: Instant,
}

#[derive(Debug, Clone, Copy)]
enum State {
    Ours,
    InFlight,
    Done(Completion),
}

/// State shared by the callbacks and the ring.
struct Shared {
    states: Mutex<Vec<State>>,
    changed: Condvar,
}

impl Shared {
    /// Locks the states. A poisoned lock is safe to use, as each state is written in a single assignment.
    fn lock(&self) -> MutexGuard<'_, Vec<State>> {
        self.states.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The user data of a transfer's callback.
struct Tag {
    shared: Arc<Shared>,
    slot: usize,
}

/// One transfer with its buffer, allocated once. It holds raw pointers because libusb and the kernel write to the
/// memory; a `Box` would promise exclusive access.
struct Transfer {
    raw: NonNull<libusb_transfer>,
    buffer: NonNull<u8>,
    tag: NonNull<Tag>,
}

/// Bulk transfers from one endpoint, completed in order.
pub(super) struct Ring {
    opened: Arc<Opened>,
    shared: Arc<Shared>,
    transfers: Vec<Transfer>,
    bytes: usize,
    /// The transfer that completes next.
    head: usize,
    events: Option<Events>,
}

// SAFETY: the pointers belong to the ring alone. libusb may be called from any thread, and what its callbacks touch
// concurrently is behind the lock of `Shared`.
unsafe impl Send for Ring {}

impl Ring {
    /// Allocates `count` transfers of `bytes` bytes each; none is in flight yet.
    pub(super) fn new(
        opened: Arc<Opened>,
        endpoint: u8,
        count: usize,
        bytes: usize,
    ) -> Result<Self, Error> {
        let length = c_int::try_from(bytes).map_err(|_| Error::InvalidParam)?;
        if count == 0 || bytes == 0 {
            return Err(Error::InvalidParam);
        }
        let shared = Arc::new(Shared {
            states: Mutex::new(vec![State::Ours; count]),
            changed: Condvar::new(),
        });
        let mut ring = Self {
            opened,
            shared,
            transfers: Vec::with_capacity(count),
            bytes,
            head: 0,
            events: None,
        };
        for slot in 0..count {
            // SAFETY: 0 isochronous packets is valid for a bulk transfer; the result is checked.
            let raw = unsafe { libusb_alloc_transfer(0) };
            let raw = NonNull::new(raw).ok_or(Error::NoMem)?;
            let buffer = vec![0u8; bytes].into_boxed_slice();
            let tag = Box::new(Tag {
                shared: Arc::clone(&ring.shared),
                slot,
            });
            let transfer = Transfer {
                raw,
                buffer: NonNull::from(Box::leak(buffer)).cast(),
                tag: NonNull::from(Box::leak(tag)),
            };
            // SAFETY: `raw` was just allocated; handle, buffer and tag live until it is freed in `Transfer::free`,
            // or for ever. There is no timeout: libusb would cancel all transfers of a quiet device at once, and a
            // cancelled transfer may lose bytes.
            unsafe {
                libusb_fill_bulk_transfer(
                    raw.as_ptr(),
                    ring.opened.handle.as_raw(),
                    endpoint,
                    transfer.buffer.as_ptr(),
                    length,
                    ended,
                    transfer.tag.as_ptr().cast(),
                    0,
                );
            }
            ring.transfers.push(transfer);
        }
        Ok(ring)
    }

    /// Submits all transfers, none of which may be in flight. Returns how many are in flight afterwards: fewer than
    /// all if the kernel has no memory for more.
    pub(super) fn submit_all(&mut self) -> Result<usize, Error> {
        if self.events.is_none() {
            self.events = Some(Events::start(&self.opened)?);
        }
        let all_ours = |states: &[State]| states.iter().all(|state| matches!(state, State::Ours));
        if !all_ours(&self.shared.lock()) {
            return Err(Error::Busy);
        }
        self.head = 0;
        for slot in 0..self.transfers.len() {
            match self.submit(slot) {
                Ok(()) => {}
                Err(Error::NoMem) if slot > 0 => {
                    self.shrink(slot);
                    break;
                }
                Err(error) => return Err(error),
            }
        }
        Ok(self.transfers.len())
    }

    /// Keeps the first `count` transfers and frees the others, which must be ours.
    fn shrink(&mut self, count: usize) {
        for transfer in self.transfers.drain(count..) {
            // SAFETY: these transfers follow one whose submission failed, so none of them is in flight.
            unsafe { transfer.free(self.bytes) };
        }
        self.shared.lock().truncate(count);
    }

    fn submit(&mut self, slot: usize) -> Result<(), Error> {
        // Set before the call, because the callback may run before the call returns.
        self.shared.lock()[slot] = State::InFlight;
        // SAFETY: the transfer is ours and filled, and nobody reads its buffer: `bytes` returns a borrow of the
        // ring, which is borrowed mutably here.
        let result = unsafe { libusb_submit_transfer(self.transfers[slot].raw.as_ptr()) };
        if result == 0 {
            return Ok(());
        }
        // The submission failed, so no callback will run.
        self.shared.lock()[slot] = State::Ours;
        Err(error(result))
    }

    /// Waits until the head has ended, and returns how. Returns `None` at `until`, and at once if the head is ours.
    pub(super) fn wait(&self, until: Instant) -> Option<Completion> {
        let mut states = self.shared.lock();
        loop {
            match states[self.head] {
                State::Done(completion) => return Some(completion),
                State::Ours => return None,
                State::InFlight => {}
            }
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return None;
            }
            states = self
                .shared
                .changed
                .wait_timeout(states, left)
                .unwrap_or_else(PoisonError::into_inner)
                .0;
        }
    }

    /// Returns whether the head is ours: neither in flight nor with a result to read.
    pub(super) fn head_is_ours(&self) -> bool {
        matches!(self.shared.lock()[self.head], State::Ours)
    }

    /// Returns the first `length` bytes of the head; empty while it is in flight.
    pub(super) fn bytes(&self, length: usize) -> &[u8] {
        if matches!(self.shared.lock()[self.head], State::InFlight) {
            return &[];
        }
        let buffer = self.transfers[self.head].buffer.as_ptr();
        // SAFETY: the buffer is ours, was zeroed when it was allocated, has `self.bytes` bytes, and is submitted
        // again only through `&mut self`, when this borrow has ended.
        unsafe { std::slice::from_raw_parts(buffer, length.min(self.bytes)) }
    }

    /// Releases the head after its bytes were read, and moves on to the next transfer. With `again`, the released
    /// transfer is submitted again.
    pub(super) fn release(&mut self, again: bool) -> Result<(), Error> {
        let slot = self.head;
        let mut states = self.shared.lock();
        if matches!(states[slot], State::Done(_)) {
            states[slot] = State::Ours;
        }
        let ours = matches!(states[slot], State::Ours);
        drop(states);
        self.head = (slot + 1) % self.transfers.len();
        if again && ours {
            self.submit(slot)?;
        }
        Ok(())
    }

    /// Cancels the head, which then completes with what it has received so far.
    pub(super) fn cancel_head(&mut self) {
        self.cancel(self.head);
    }

    /// Cancels all transfers.
    pub(super) fn cancel_all(&mut self) {
        // In reverse order, so that no earlier transfer takes bytes meant for a cancelled one.
        for step in (0..self.transfers.len()).rev() {
            self.cancel((self.head + step) % self.transfers.len());
        }
    }

    fn cancel(&mut self, slot: usize) {
        if matches!(self.shared.lock()[slot], State::InFlight) {
            // SAFETY: the transfer is allocated; libusb refuses to cancel one that has ended in the meantime. Its
            // callback reports the end in any case, so the result can be ignored.
            let _ = unsafe { libusb_cancel_transfer(self.transfers[slot].raw.as_ptr()) };
        }
    }

    /// Waits until no transfer is in flight; returns `false` if some still are after `limit`.
    fn wait_all(&self, limit: Duration) -> bool {
        let until = Instant::now() + limit;
        let mut states = self.shared.lock();
        while states.iter().any(|state| matches!(state, State::InFlight)) {
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return false;
            }
            states = self
                .shared
                .changed
                .wait_timeout(states, left)
                .unwrap_or_else(PoisonError::into_inner)
                .0;
        }
        true
    }
}

impl Drop for Ring {
    fn drop(&mut self) {
        self.cancel_all();
        let all_back = self.wait_all(Duration::from_secs(5));
        // After this, callbacks run only on threads that wait for a control request.
        self.events = None;
        if all_back {
            for transfer in self.transfers.drain(..) {
                // SAFETY: none is in flight, by `wait_all`, and none is submitted any more.
                unsafe { transfer.free(self.bytes) };
            }
        } else {
            // libusb still holds a transfer: its memory and the open device are leaked, so that they stay valid.
            std::mem::forget(Arc::clone(&self.opened));
        }
    }
}

impl Transfer {
    /// Frees the transfer, its buffer and its tag.
    ///
    /// # Safety
    /// The transfer must not be in flight, and its buffer must have `bytes` bytes.
    unsafe fn free(self, bytes: usize) {
        // SAFETY: by the caller's promise nobody else uses any of the three. Buffer and tag came from boxes of
        // these types, and the buffer has this length.
        unsafe {
            libusb_free_transfer(self.raw.as_ptr());
            let buffer = ptr::slice_from_raw_parts_mut(self.buffer.as_ptr(), bytes);
            drop(Box::from_raw(buffer));
            drop(Box::from_raw(self.tag.as_ptr()));
        }
    }
}

/// The callback of every transfer: records how the transfer ended, and nothing else. It cannot panic: its slot
/// exists, because only slots of transfers that were never submitted are cut off.
extern "system" fn ended(raw: *mut libusb_transfer) {
    let at = Instant::now();
    // SAFETY: libusb calls this once per submission, with the submitted transfer, which is not freed while it is in
    // flight; its `user_data` is its tag, which is freed together with it.
    let (status, length, shared, slot) = unsafe {
        let tag = (*raw).user_data.cast::<Tag>();
        // The ring may free the tag as soon as the state is Done, so everything needed after that is copied out
        // first.
        let shared = Arc::clone(&(*tag).shared);
        ((*raw).status, (*raw).actual_length, shared, (*tag).slot)
    };
    let status = match status {
        LIBUSB_TRANSFER_COMPLETED => Status::Complete,
        LIBUSB_TRANSFER_CANCELLED | LIBUSB_TRANSFER_TIMED_OUT => Status::Cancelled,
        LIBUSB_TRANSFER_STALL => Status::Stalled,
        LIBUSB_TRANSFER_OVERFLOW => Status::Overflow,
        LIBUSB_TRANSFER_NO_DEVICE => Status::NoDevice,
        _ => Status::Failed,
    };
    if let Some(state) = shared.lock().get_mut(slot) {
        *state = State::Done(Completion {
            status,
            length: usize::try_from(length).unwrap_or(0),
            at,
        });
    }
    shared.changed.notify_all();
}

/// The thread that handles libusb's events.
struct Events {
    opened: Arc<Opened>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Events {
    fn start(opened: &Arc<Opened>) -> Result<Self, Error> {
        let stop = Arc::new(AtomicBool::new(false));
        let (context, stopped) = (opened.handle.context().clone(), Arc::clone(&stop));
        let thread = thread::Builder::new()
            .name("usb events".to_owned())
            .spawn(move || {
                while !stopped.load(Ordering::Acquire) {
                    if context.handle_events(Some(Duration::from_secs(1))).is_err() {
                        // Interrupted, or out of some system resource: do not retry at full speed.
                        thread::sleep(Duration::from_millis(1));
                    }
                }
            })
            .map_err(|_| Error::NoMem)?;
        Ok(Self {
            opened: Arc::clone(opened),
            stop,
            thread: Some(thread),
        })
    }
}

impl Drop for Events {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        // SAFETY: the context lives as long as the device that holds it.
        unsafe { libusb_interrupt_event_handler(self.opened.handle.context().as_raw()) };
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Converts libusb's result code of a submission into rusb's error.
fn error(result: c_int) -> Error {
    match result {
        LIBUSB_ERROR_NO_DEVICE => Error::NoDevice,
        LIBUSB_ERROR_IO => Error::Io,
        LIBUSB_ERROR_BUSY => Error::Busy,
        LIBUSB_ERROR_NO_MEM => Error::NoMem,
        LIBUSB_ERROR_NOT_SUPPORTED => Error::NotSupported,
        LIBUSB_ERROR_INVALID_PARAM => Error::InvalidParam,
        _ => Error::Other,
    }
}
