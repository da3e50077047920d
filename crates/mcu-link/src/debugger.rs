//! The debugger's port of an emulator: stops it, reads and writes its memory and registers (GDB's remote protocol).

use std::io::{self, BufRead, BufReader, ErrorKind, Read, Write};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::thread;
use std::time::{Duration, Instant};

use event_types::bail;
use event_types::stream::{Context, Result};

/// Time that the emulator has to open its port, and to answer.
const PATIENCE: Duration = Duration::from_secs(10);
/// Longest answer.
const ANSWER_BYTES: u64 = 1 << 12;

/// A connection to a stopped emulator.
#[derive(Debug)]
pub struct Debugger {
    stream: UnixStream,
    answers: BufReader<UnixStream>,
}

impl Debugger {
    /// Connects to an emulator that waits for a debugger.
    ///
    /// # Errors
    /// It does not open its port.
    pub(crate) fn connect(socket: &Path) -> Result<Self> {
        let started = Instant::now();
        let stream = loop {
            match UnixStream::connect(socket) {
                Ok(stream) => break stream,
                Err(error) if started.elapsed() > PATIENCE => {
                    return Err(error).with_context(|| socket.display().to_string());
                }
                Err(_) => thread::sleep(Duration::from_millis(2)),
            }
        };
        stream.set_read_timeout(Some(PATIENCE))?;
        let answers = BufReader::new(stream.try_clone()?);
        let mut debugger = Self { stream, answers };
        debugger.ask("QStartNoAckMode")?;
        // The last packet that is acknowledged is that answer.
        debugger.stream.write_all(b"+")?;
        // QEMU gives single registers to those alone who have asked which there are.
        debugger.ask("qXfer:features:read:target.xml:0,100")?;
        Ok(debugger)
    }

    /// Lets the emulator go on.
    ///
    /// # Errors
    /// It has ended.
    pub fn go_on(&mut self) -> Result<()> {
        Ok(self.send("c")?)
    }

    /// Stops the emulator; returns `false` if it has ended before, or is in a call of the host's that does not end.
    ///
    /// # Errors
    /// The connection fails.
    pub fn stop(&mut self) -> Result<bool> {
        match self.stream.write_all(&[3]).and_then(|()| self.answer()) {
            // `W` and `X`: it has ended.
            Ok(answer) => Ok(answer.starts_with(['S', 'T'])),
            Err(error) if has_ended(&error) => Ok(false),
            Err(error) => Err(error.into()),
        }
    }

    /// Reads a byte of memory.
    ///
    /// # Errors
    /// There is no memory.
    pub fn byte(&mut self, address: u32) -> Result<u8> {
        let answer = self.ask(&format!("m{address:x},1"))?;
        u8::from_str_radix(&answer, 16).with_context(|| format!("memory at {address:#x}: {answer}"))
    }

    /// Writes a byte of memory.
    ///
    /// # Errors
    /// There is no memory.
    pub fn set_byte(&mut self, address: u32, byte: u8) -> Result<()> {
        self.change(&format!("M{address:x},1:{byte:02x}"))
    }

    /// Lets the processor write a word, such as a register of a peripheral, which a debugger cannot write itself; `scratch`
    /// is two bytes of memory that nobody uses.
    ///
    /// # Errors
    /// There is no memory.
    pub fn store(&mut self, address: u32, word: u32, scratch: u32) -> Result<()> {
        const PC: u8 = 15;
        // str r1, [r0]
        const STORE: [u8; 2] = [0x01, 0x60];
        let mut before = Vec::new();
        for register in [0, 1, PC] {
            before.push((register, self.register(register)?));
        }
        for (at, byte) in (scratch..).zip(STORE) {
            self.set_byte(at, byte)?;
        }
        for (register, word) in [(0, address), (1, word), (PC, scratch)] {
            self.set_register(register, word)?;
        }
        self.ask("s")?;
        for (register, word) in before {
            self.set_register(register, word)?;
        }
        Ok(())
    }

    /// Reads a register of the processor: 0 to 15 are r0 to pc, 25 is the status.
    ///
    /// # Errors
    /// There is no such register.
    pub fn register(&mut self, number: u8) -> Result<u32> {
        let answer = self.ask(&format!("p{number:x}"))?;
        let word = u32::from_str_radix(&answer, 16)
            .with_context(|| format!("register {number}: {answer}"))?;
        Ok(word.swap_bytes())
    }

    /// Writes a register of the processor, see [`Self::register`].
    ///
    /// # Errors
    /// There is no such register.
    pub fn set_register(&mut self, number: u8, word: u32) -> Result<()> {
        let word = word.swap_bytes();
        self.change(&format!("P{number:x}={word:08x}"))
    }

    fn change(&mut self, packet: &str) -> Result<()> {
        match self.ask(packet)?.as_str() {
            "OK" => Ok(()),
            answer => bail!(Refused, "{packet}: {answer}"),
        }
    }

    fn ask(&mut self, packet: &str) -> Result<String> {
        self.send(packet)?;
        Ok(self.answer()?)
    }

    fn send(&mut self, packet: &str) -> io::Result<()> {
        let sum = packet.bytes().fold(0_u8, u8::wrapping_add);
        self.stream
            .write_all(format!("${packet}#{sum:02x}").as_bytes())
    }

    /// Returns the content of the next packet.
    fn answer(&mut self) -> io::Result<String> {
        let mut answers = self.answers.by_ref().take(ANSWER_BYTES);
        let mut answer = Vec::new();
        answers.read_until(b'$', &mut answer)?;
        answer.clear();
        answers.read_until(b'#', &mut answer)?;
        if answer.pop() != Some(b'#') {
            // Too long, or the end.
            return Err(ErrorKind::UnexpectedEof.into());
        }
        // The sum: the socket loses nothing.
        self.answers.read_exact(&mut [0; 2])?;
        Ok(String::from_utf8_lossy(&answer).into_owned())
    }
}

/// Whether an error means that the emulator has closed the port, or no longer answers.
fn has_ended(error: &io::Error) -> bool {
    matches!(
        error.kind(),
        ErrorKind::UnexpectedEof
            | ErrorKind::BrokenPipe
            | ErrorKind::ConnectionReset
            | ErrorKind::WouldBlock
            | ErrorKind::TimedOut
    )
}
