//! The protocol of umockdev's preloaded library: what a program does with a device's node.
//!
//! For each node that the program opens, the library connects to the device's socket. Both sides send requests of three
//! words of the machine's size, in its byte order:
//!
//! | command | from | arguments |
//! |---|---|---|
//! | 1 | library | an ioctl: its number, its argument |
//! | 7, 8 | library | a read, a write: address, length |
//! | 3 | server | the call ends: result, errno |
//! | 4 | server | the call shall go to the file; 2 with result and errno comes back |
//! | 5 | server | address, length: the library sends that memory of the program |
//! | 6 | server | address, length, followed by as many bytes: the library writes them there |

use std::io::{self, Read, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{Builder, JoinHandle};
use std::time::Duration;

use anyhow::{Context, Result};

use super::kernel::{Submitted, Usbfs};

const IOCTL: u64 = 1;
const READ: u64 = 7;
const WRITE: u64 = 8;
const DONE: u64 = 3;
const RUN: u64 = 4;
const READ_MEMORY: u64 = 5;
const WRITE_MEMORY: u64 = 6;

/// Most bytes of one transfer, as in Linux's usbfs by default.
const TRANSFER_BYTES_MAX: usize = 16 << 20;

/// Type of usbfs' ioctls, in bits 15..8 of their number.
const USBFS: u64 = b'U' as u64;
/// Largest argument of an ioctl other than those of transfers.
const ARGUMENT_BYTES_MAX: usize = 1 << 12;

// Numbers of ioctls.
const SUBMIT: u64 = 10;
const DISCARD: u64 = 11;
const REAP: u64 = 12;
const REAP_NOW: u64 = 13;

/// Layout of `struct usbdevfs_urb` on machines of 64 bits.
const URB_BYTES: usize = 56;
const URB_STATUS: u64 = 4;
const URB_FLAGS: usize = 8;
const URB_BUFFER: usize = 16;
const URB_LENGTH: usize = 24;
const URB_ACTUAL: u64 = 28;
/// Bytes of a control transfer's setup packet, before its data.
const SETUP_BYTES: u64 = 8;

const EAGAIN: i32 = 11;
const EINVAL: i32 = 22;
const ENOTTY: i32 = 25;

/// How long a program that has nothing to reap waits until it asks again.
const PAUSE: Duration = Duration::from_micros(50);
/// Period at which the server checks whether it shall end.
const LOOK: Duration = Duration::from_millis(5);

/// Answers a device's socket in threads of its own until it is dropped.
pub struct Server {
    ends: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Server {
    /// Listens at `socket`.
    pub fn start(socket: &Path, usbfs: &Arc<Mutex<Usbfs>>) -> Result<Self> {
        let listener = UnixListener::bind(socket)
            .with_context(|| format!("{}: cannot listen there", socket.display()))?;
        // For programs of whatever user.
        std::fs::set_permissions(socket, std::os::unix::fs::PermissionsExt::from_mode(0o777))
            .context("setting the permissions of the socket")?;
        listener.set_nonblocking(true).context("socket")?;
        let ends = Arc::<AtomicBool>::default();
        let (to_end, usbfs) = (Arc::clone(&ends), Arc::clone(usbfs));
        let thread = Builder::new()
            .name("usbfs".to_owned())
            .spawn(move || {
                while !to_end.load(Ordering::Relaxed) {
                    let Ok((connection, _)) = listener.accept() else {
                        std::thread::sleep(LOOK);
                        continue;
                    };
                    let usbfs = Arc::clone(&usbfs);
                    // The thread ends with the program's end of the socket. If none can be started, the program is
                    // cut off and says so.
                    let _ = Builder::new().spawn(move || {
                        let _ = serve(connection, &usbfs);
                    });
                }
            })
            .context("starting the usbfs thread")?;
        Ok(Self {
            ends,
            thread: Some(thread),
        })
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Answers a program until it closes the node.
fn serve(connection: UnixStream, usbfs: &Mutex<Usbfs>) -> io::Result<()> {
    connection.set_nonblocking(false)?;
    let mut program = Program { connection };
    loop {
        let [command, first, second] = program.receive()?;
        match command {
            IOCTL => {
                let result = program.ioctl(first, second, usbfs)?;
                program.end(result)?;
            }
            READ | WRITE => {
                program.send([RUN, 0, 0])?;
                let [_, result, error] = program.receive()?;
                program.send([DONE, result, error])?;
            }
            _ => return Err(io::ErrorKind::InvalidData.into()),
        }
    }
}

/// The program, through the library in it.
struct Program {
    connection: UnixStream,
}

impl Program {
    fn receive(&mut self) -> io::Result<[u64; 3]> {
        let mut bytes = [0; 24];
        self.connection.read_exact(&mut bytes)?;
        let word = |at: usize| u64_at(&bytes, at);
        Ok([word(0), word(8), word(16)])
    }

    fn send(&mut self, words: [u64; 3]) -> io::Result<()> {
        self.connection
            .write_all(words.map(u64::to_ne_bytes).as_flattened())
    }

    /// Ends a call with its result, or with an error if that is negative.
    fn end(&mut self, result: i32) -> io::Result<()> {
        let [result, error] = if result < 0 {
            [u64::MAX, result.unsigned_abs().into()]
        } else {
            [result.unsigned_abs().into(), 0]
        };
        self.send([DONE, result, error])
    }

    fn read_memory(&mut self, address: u64, bytes: &mut [u8]) -> io::Result<()> {
        if bytes.is_empty() {
            return Ok(());
        }
        self.send([READ_MEMORY, address, bytes.len() as u64])?;
        self.connection.read_exact(bytes)
    }

    fn write_memory(&mut self, address: u64, bytes: &[u8]) -> io::Result<()> {
        if bytes.is_empty() {
            return Ok(());
        }
        self.send([WRITE_MEMORY, address, bytes.len() as u64])?;
        self.connection.write_all(bytes)
    }

    /// Answers an ioctl; returns its result, or an error of the system as a negative number.
    fn ioctl(&mut self, request: u64, argument: u64, usbfs: &Mutex<Usbfs>) -> io::Result<i32> {
        if request >> 8 & 0xFF != USBFS {
            return Ok(-ENOTTY);
        }
        let usbfs = || usbfs.lock().unwrap_or_else(PoisonError::into_inner);
        match request & 0xFF {
            SUBMIT => {
                let mut urb = [0; URB_BYTES];
                self.read_memory(argument, &mut urb)?;
                let [kind, endpoint, ..] = urb;
                let buffer = u64_at(&urb, URB_BUFFER);
                let length = u32_at(&urb, URB_LENGTH) as usize;
                if length > TRANSFER_BYTES_MAX {
                    return Ok(-EINVAL);
                }
                let sends = Submitted::is_sent(kind, endpoint);
                let mut data = vec![0; if sends { length } else { 0 }];
                self.read_memory(buffer, &mut data)?;
                Ok(usbfs().submit(Submitted {
                    address: argument,
                    kind,
                    endpoint,
                    flags: u32_at(&urb, URB_FLAGS),
                    buffer,
                    length,
                    data,
                }))
            }
            DISCARD => Ok(usbfs().discard(argument)),
            number @ (REAP | REAP_NOW) => loop {
                let reaped = usbfs().reap();
                match reaped {
                    Ok(ended) => {
                        let setup = if ended.is_control { SETUP_BYTES } else { 0 };
                        self.write_memory(ended.buffer + setup, &ended.data)?;
                        let (status, actual) = (ended.status, ended.actual);
                        self.write_memory(ended.address + URB_STATUS, &status.to_ne_bytes())?;
                        self.write_memory(ended.address + URB_ACTUAL, &actual.to_ne_bytes())?;
                        self.write_memory(argument, &ended.address.to_ne_bytes())?;
                        return Ok(0);
                    }
                    Err(error) if error == EAGAIN => {
                        // A node that is always ready is asked without a pause: one is made here.
                        std::thread::sleep(PAUSE);
                        if number == REAP_NOW {
                            return Ok(-EAGAIN);
                        }
                    }
                    Err(error) => return Ok(-error),
                }
            },
            number => {
                let length = (request >> 16 & 0x3FFF) as usize;
                if length > ARGUMENT_BYTES_MAX {
                    return Ok(-EINVAL);
                }
                let mut bytes = vec![0; length];
                self.read_memory(argument, &mut bytes)?;
                let (result, answer) = usbfs().ioctl(number as u32, &bytes);
                if answer.len() <= length {
                    self.write_memory(argument, &answer)?;
                }
                Ok(result)
            }
        }
    }
}

fn u64_at(bytes: &[u8], at: usize) -> u64 {
    let word = bytes.get(at..).and_then(<[u8]>::first_chunk);
    u64::from_ne_bytes(word.copied().unwrap_or_default())
}

fn u32_at(bytes: &[u8], at: usize) -> u32 {
    let word = bytes.get(at..).and_then(<[u8]>::first_chunk);
    u32::from_ne_bytes(word.copied().unwrap_or_default())
}
