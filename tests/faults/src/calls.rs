//! The C library's functions that change files, in front of its own.
//!
//! Each has the signature that the C library documents; `open` and its like are variadic there, and their third
//! argument is passed as an ordinary one is on every 64-bit Linux that Rust supports.

// Exported names replace those of the C library, and pointers come from its callers.
#![allow(unsafe_code)]

use std::ffi::{c_char, c_int, c_long, c_uint, c_void};

use libc::{iovec, mode_t, off_t, size_t, ssize_t, syscall};

use crate::plan::{Place, Verdict, raise, verdict};

/// Sets the error number, and returns the value by which a function fails.
fn failed(number: c_int) -> c_long {
    // SAFETY: the C library gives every thread a place for its error number.
    unsafe { *libc::__errno_location() = number };
    -1
}

/// Runs a call, unless it is to fail.
fn call(name: &str, place: Place, needs_room: bool, run: impl FnOnce() -> c_long) -> c_long {
    match verdict(name, place, needs_room) {
        Verdict::Fail(number) => failed(number),
        _ => run(),
    }
}

/// Runs a call that writes `count` bytes; `run` writes as many as it is told.
fn writing(place: Place, count: size_t, run: impl FnOnce(size_t) -> c_long) -> c_long {
    match verdict("write", place, true) {
        Verdict::Fail(number) => failed(number),
        Verdict::Half => run(count.div_ceil(2)),
        Verdict::HalfAndEnd => {
            run(count.div_ceil(2));
            raise(libc::SIGKILL);
            failed(libc::EINTR)
        }
        Verdict::Go => run(count),
    }
}

/// Whether opening with these flags changes anything.
const fn changes(flags: c_int) -> bool {
    flags & (libc::O_ACCMODE | libc::O_CREAT | libc::O_TRUNC) != 0
}

fn opening(folder: c_int, path: *const c_char, flags: c_int, mode: c_uint) -> c_int {
    // SAFETY: the caller's path ends in a zero.
    let run = || unsafe { syscall(libc::SYS_openat, folder, path, flags, mode) };
    let fd = match changes(flags) {
        true => call("open", Place::Name(folder, path), true, run),
        false => run(),
    };
    fd as c_int
}

/// Defines exported functions. Their safety is that of the function of this name in the C library.
macro_rules! exported {
    ($($name:ident($($argument:ident: $kind:ty),*) -> $result:ty $body:block)*) => {
        $(
            /// In front of the C library's function of this name.
            ///
            /// # Safety
            /// That of the C library's function: pointers are valid, names end in a zero.
            #[unsafe(no_mangle)]
            pub unsafe extern "C" fn $name($($argument: $kind),*) -> $result $body
        )*
    };
}

// SAFETY of every block below: the arguments go to the kernel as the caller gave them, who has promised that they are
// valid; a count is never raised.
#[allow(clippy::undocumented_unsafe_blocks)]
mod exports {
    use super::*;

    exported! {
        write(fd: c_int, bytes: *const c_void, count: size_t) -> ssize_t {
            writing(Place::Open(fd), count, |count| unsafe {
                syscall(libc::SYS_write, fd, bytes, count)
            }) as ssize_t
        }

        writev(fd: c_int, parts: *const iovec, count: c_int) -> ssize_t {
            // Half of the parts; a single one is written in full or not at all.
            writing(Place::Open(fd), count as size_t, |count| unsafe {
                syscall(libc::SYS_writev, fd, parts, count)
            }) as ssize_t
        }

        pwrite(fd: c_int, bytes: *const c_void, count: size_t, at: off_t) -> ssize_t {
            writing(Place::Open(fd), count, |count| unsafe {
                syscall(libc::SYS_pwrite64, fd, bytes, count, at)
            }) as ssize_t
        }

        pwrite64(fd: c_int, bytes: *const c_void, count: size_t, at: off_t) -> ssize_t {
            unsafe { pwrite(fd, bytes, count, at) }
        }

        copy_file_range(
            from: c_int, from_at: *mut off_t, to: c_int, to_at: *mut off_t, count: size_t, flags: c_uint
        ) -> ssize_t {
            writing(Place::Open(to), count, |count| unsafe {
                syscall(libc::SYS_copy_file_range, from, from_at, to, to_at, count, flags)
            }) as ssize_t
        }

        sendfile(to: c_int, from: c_int, at: *mut off_t, count: size_t) -> ssize_t {
            writing(Place::Open(to), count, |count| unsafe {
                syscall(libc::SYS_sendfile, to, from, at, count)
            }) as ssize_t
        }

        sendfile64(to: c_int, from: c_int, at: *mut off_t, count: size_t) -> ssize_t {
            unsafe { sendfile(to, from, at, count) }
        }

        fsync(fd: c_int) -> c_int {
            call("sync", Place::Open(fd), false, || unsafe {
                syscall(libc::SYS_fsync, fd)
            }) as c_int
        }

        fdatasync(fd: c_int) -> c_int {
            call("sync", Place::Open(fd), false, || unsafe {
                syscall(libc::SYS_fdatasync, fd)
            }) as c_int
        }

        ftruncate(fd: c_int, length: off_t) -> c_int {
            call("truncate", Place::Open(fd), true, || unsafe {
                syscall(libc::SYS_ftruncate, fd, length)
            }) as c_int
        }

        ftruncate64(fd: c_int, length: off_t) -> c_int {
            unsafe { ftruncate(fd, length) }
        }

        fchmod(fd: c_int, mode: mode_t) -> c_int {
            call("chmod", Place::Open(fd), false, || unsafe {
                syscall(libc::SYS_fchmod, fd, mode)
            }) as c_int
        }

        chmod(path: *const c_char, mode: mode_t) -> c_int {
            call("chmod", Place::Name(libc::AT_FDCWD, path), false, || unsafe {
                syscall(libc::SYS_fchmodat, libc::AT_FDCWD, path, mode)
            }) as c_int
        }

        open(path: *const c_char, flags: c_int, mode: c_uint) -> c_int {
            opening(libc::AT_FDCWD, path, flags, mode)
        }

        open64(path: *const c_char, flags: c_int, mode: c_uint) -> c_int {
            opening(libc::AT_FDCWD, path, flags, mode)
        }

        openat(folder: c_int, path: *const c_char, flags: c_int, mode: c_uint) -> c_int {
            opening(folder, path, flags, mode)
        }

        openat64(folder: c_int, path: *const c_char, flags: c_int, mode: c_uint) -> c_int {
            opening(folder, path, flags, mode)
        }

        rename(from: *const c_char, to: *const c_char) -> c_int {
            call("rename", Place::Name(libc::AT_FDCWD, to), true, || unsafe {
                syscall(libc::SYS_renameat2, libc::AT_FDCWD, from, libc::AT_FDCWD, to, 0)
            }) as c_int
        }

        renameat(of_from: c_int, from: *const c_char, of_to: c_int, to: *const c_char) -> c_int {
            call("rename", Place::Name(of_to, to), true, || unsafe {
                syscall(libc::SYS_renameat2, of_from, from, of_to, to, 0)
            }) as c_int
        }

        mkdir(path: *const c_char, mode: mode_t) -> c_int {
            call("mkdir", Place::Name(libc::AT_FDCWD, path), true, || unsafe {
                syscall(libc::SYS_mkdirat, libc::AT_FDCWD, path, mode)
            }) as c_int
        }

        mkdirat(folder: c_int, path: *const c_char, mode: mode_t) -> c_int {
            call("mkdir", Place::Name(folder, path), true, || unsafe {
                syscall(libc::SYS_mkdirat, folder, path, mode)
            }) as c_int
        }

        unlink(path: *const c_char) -> c_int {
            call("unlink", Place::Name(libc::AT_FDCWD, path), false, || unsafe {
                syscall(libc::SYS_unlinkat, libc::AT_FDCWD, path, 0)
            }) as c_int
        }

        unlinkat(folder: c_int, path: *const c_char, flags: c_int) -> c_int {
            call("unlink", Place::Name(folder, path), false, || unsafe {
                syscall(libc::SYS_unlinkat, folder, path, flags)
            }) as c_int
        }

        rmdir(path: *const c_char) -> c_int {
            call("unlink", Place::Name(libc::AT_FDCWD, path), false, || unsafe {
                syscall(libc::SYS_unlinkat, libc::AT_FDCWD, path, libc::AT_REMOVEDIR)
            }) as c_int
        }
    }
}
