//! What happens at which call.

// The kernel is asked directly; each block says why its pointers are valid.
#![allow(unsafe_code)]

use std::ffi::{CStr, c_char, c_int, c_long};
use std::sync::atomic::{AtomicI32, AtomicPtr, AtomicU32, AtomicU64, Ordering};

use libc::{SYS_getpid, SYS_kill, SYS_openat, SYS_readlinkat, SYS_write, syscall};

/// What a call does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// What it always does.
    Go,
    /// It fails with this error number.
    Fail(c_int),
    /// If it writes, it writes half of its bytes.
    Half,
    /// If it writes, it writes half of its bytes; then the process is killed.
    HalfAndEnd,
}

/// Kinds of plans, by the letter behind the number of the call.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
enum Act {
    /// `-`: nothing happens; calls are only listed.
    Nothing = 0,
    /// `e28`: the call fails with error number 28.
    Fail,
    /// `s`: a short write.
    Short,
    /// `f`: a short write, or else a failure; every later call that needs room fails too, as on a full disk.
    Full,
    /// `k`: the process is killed before the call.
    Kill,
    /// `h`: the process is killed when half of the bytes are written.
    KillHalf,
    /// `g15`: the process gets signal 15 before the call.
    Signal,
}

const ACTS: [(u8, Act); 7] = [
    (b'-', Act::Nothing),
    (b'e', Act::Fail),
    (b's', Act::Short),
    (b'f', Act::Full),
    (b'k', Act::Kill),
    (b'h', Act::KillHalf),
    (b'g', Act::Signal),
];

const PATH_BYTES: usize = 4096;

static FOLDER: AtomicPtr<c_char> = AtomicPtr::new(std::ptr::null_mut());
static LOG: AtomicI32 = AtomicI32::new(-1);
static AT: AtomicU64 = AtomicU64::new(0);
static ACT: AtomicU32 = AtomicU32::new(0);
static NUMBER: AtomicI32 = AtomicI32::new(0);
static CALLS: AtomicU64 = AtomicU64::new(0);

/// Reads the plan before the program begins.
#[used]
#[unsafe(link_section = ".init_array")]
static BEGIN: extern "C" fn() = begin;

extern "C" fn begin() {
    let folder = variable(c"EECVS_FAULTS_FOLDER");
    let log = variable(c"EECVS_FAULTS_LOG");
    let plan = variable(c"EECVS_FAULTS_PLAN");
    let (Some(folder), Some(log), Some(plan)) = (folder, log, plan) else {
        return;
    };
    let flags = libc::O_WRONLY | libc::O_CREAT | libc::O_APPEND | libc::O_CLOEXEC;
    // SAFETY: the path ends in a zero, and lives as long as the environment.
    let fd = unsafe { syscall(SYS_openat, libc::AT_FDCWD, log.as_ptr(), flags, 0o644) };
    LOG.store(fd as i32, Ordering::Relaxed);
    let (mut at, mut number, mut act) = (0_u64, 0_i32, None);
    for byte in plan.to_bytes() {
        let digit = u64::from(byte.wrapping_sub(b'0'));
        match act {
            None if byte.is_ascii_digit() => at = at * 10 + digit,
            None => {
                let known = ACTS.iter().find(|(letter, _)| letter == byte);
                act = known.map(|(_, act)| *act);
            }
            Some(_) => number = number * 10 + digit as i32,
        }
    }
    AT.store(at, Ordering::Relaxed);
    NUMBER.store(number, Ordering::Relaxed);
    ACT.store(act.unwrap_or(Act::Nothing) as u32, Ordering::Relaxed);
    FOLDER.store(folder.as_ptr().cast_mut(), Ordering::Release);
}

fn variable(name: &CStr) -> Option<&'static CStr> {
    // SAFETY: the name ends in a zero. The text stays where it is: programs do not change these variables.
    unsafe {
        let text = libc::getenv(name.as_ptr());
        (!text.is_null()).then(|| CStr::from_ptr(text))
    }
}

/// Where a call takes place.
#[derive(Clone, Copy)]
pub enum Place {
    /// An open file.
    Open(c_int),
    /// A name, from an open folder on.
    Name(c_int, *const c_char),
}

/// Decides what a call does; `needs_room` is whether a full disk refuses it.
#[must_use]
pub fn verdict(call: &str, place: Place, needs_room: bool) -> Verdict {
    let folder = FOLDER.load(Ordering::Acquire);
    if folder.is_null() {
        return Verdict::Go;
    }
    // SAFETY: it is a variable of the environment, which ends in a zero and stays.
    let folder = unsafe { CStr::from_ptr(folder) }.to_bytes();
    let mut buffer = [0; PATH_BYTES];
    let Some(path) = path(place, folder, &mut buffer) else {
        return Verdict::Go;
    };
    let number = CALLS.fetch_add(1, Ordering::Relaxed) + 1;
    put(call, path);
    let at = AT.load(Ordering::Relaxed);
    let act = ACT.load(Ordering::Relaxed);
    let act = ACTS.iter().find(|(_, known)| *known as u32 == act);
    let act = act.map_or(Act::Nothing, |(_, act)| *act);
    match act {
        Act::Full if number > at && needs_room => Verdict::Fail(libc::ENOSPC),
        _ if number != at => Verdict::Go,
        Act::Nothing => Verdict::Go,
        Act::Fail => Verdict::Fail(NUMBER.load(Ordering::Relaxed)),
        Act::Short => Verdict::Half,
        Act::Full if call == "write" => Verdict::Half,
        Act::Full if needs_room => Verdict::Fail(libc::ENOSPC),
        Act::Full => Verdict::Go,
        Act::Kill => {
            raise(libc::SIGKILL);
            Verdict::Go
        }
        Act::KillHalf => Verdict::HalfAndEnd,
        Act::Signal => {
            raise(NUMBER.load(Ordering::Relaxed));
            Verdict::Go
        }
    }
}

/// Sends the process a signal.
pub fn raise(signal: c_int) {
    // SAFETY: the calls take numbers alone.
    unsafe {
        syscall(SYS_kill, syscall(SYS_getpid), signal);
    }
}

/// Returns the path of a place if it is in the folder.
fn path<'b>(place: Place, folder: &[u8], buffer: &'b mut [u8; PATH_BYTES]) -> Option<&'b [u8]> {
    let (Place::Open(fd) | Place::Name(fd, _)) = place;
    if fd >= 0 {
        let length = of_open(fd, buffer)?;
        if buffer.get(..length)?.starts_with(folder) {
            return buffer.get(..length);
        }
    }
    let Place::Name(_, name) = place else {
        return None;
    };
    let name = bytes(name);
    let is_inside = match name.first() {
        Some(b'/') => name.starts_with(folder),
        // Programs run in the folder.
        _ => fd < 0 && !name.starts_with(b".."),
    };
    if !is_inside {
        return None;
    }
    let length = name.len().min(PATH_BYTES);
    buffer
        .get_mut(..length)?
        .copy_from_slice(name.get(..length)?);
    buffer.get(..length)
}

fn bytes<'n>(name: *const c_char) -> &'n [u8] {
    // SAFETY: callers of the functions in `calls` pass names that end in a zero, as those functions ask for.
    unsafe { CStr::from_ptr(name) }.to_bytes()
}

/// Puts the path of an open file into the buffer and returns its length.
fn of_open(fd: c_int, buffer: &mut [u8; PATH_BYTES]) -> Option<usize> {
    let mut link = *b"/proc/self/fd/\0\0\0\0\0\0\0\0\0\0\0\0";
    let mut digits = [0; 10];
    let mut rest = fd;
    let mut count = 0;
    loop {
        *digits.get_mut(count)? = b'0' + (rest % 10) as u8;
        rest /= 10;
        count += 1;
        if rest == 0 {
            break;
        }
    }
    for (place, digit) in link.iter_mut().skip(14).zip(digits[..count].iter().rev()) {
        *place = *digit;
    }
    // SAFETY: the link ends in a zero, since a number has 10 digits at most; the kernel writes no more bytes than the
    // buffer has.
    let length: c_long = unsafe {
        syscall(
            SYS_readlinkat,
            libc::AT_FDCWD,
            link.as_ptr(),
            buffer.as_mut_ptr(),
            buffer.len(),
        )
    };
    usize::try_from(length).ok()
}

/// Adds a line to the list of calls.
fn put(call: &str, path: &[u8]) {
    let mut line = [0; PATH_BYTES + 64];
    let parts = [call.as_bytes(), b" ", path, b"\n"];
    let mut length = 0;
    for byte in parts.into_iter().flatten() {
        if let Some(place) = line.get_mut(length) {
            *place = *byte;
            length += 1;
        }
    }
    // SAFETY: the first `length` bytes of the line are there.
    unsafe {
        syscall(
            SYS_write,
            LOG.load(Ordering::Relaxed),
            line.as_ptr(),
            length,
        );
    }
}
