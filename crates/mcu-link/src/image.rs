//! The firmware image: its build and its sizes.

use std::io::{IsTerminal, stderr};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use event_types::bail;
use event_types::stream::{Context, Result, small_file};
use object::read::elf::ElfFile32;
use object::{Object, ObjectSection, SectionFlags, elf};

use super::qemu::Machine;

/// Largest image, in bytes.
pub(crate) const BYTES_MAX: u64 = 256 << 20;

/// Folder of the firmware, relative to these sources.
const FIRMWARE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../firmware");

/// Builds the image of `program` for a machine and returns its path.
///
/// # Errors
/// Missing firmware sources, or a failed build; the build's own messages go to stderr.
pub fn build(machine: Machine, program: &str) -> Result<PathBuf> {
    build_with(machine, program, &[])
}

/// Builds an image as [`build`] does, without the core's assembly.
///
/// # Errors
/// As those of [`build`].
pub fn build_portable(machine: Machine, program: &str) -> Result<PathBuf> {
    build_with(machine, program, &["portable"])
}

fn build_with(machine: Machine, program: &str, options: &[&str]) -> Result<PathBuf> {
    let scripts = [FIRMWARE, "firmware"].map(|folder| Path::new(folder).join("build.sh"));
    let Some(script) = scripts.iter().find(|script| script.is_file()) else {
        bail!(
            Refused,
            "no firmware sources in {FIRMWARE} or ./firmware: run this in the project's folder"
        );
    };
    let name = script.display();
    let watched = stderr().is_terminal();
    let output = Command::new(script)
        .args([machine.name(), program])
        .args(options)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(if watched {
            Stdio::inherit()
        } else {
            Stdio::piped()
        })
        .output()
        .with_context(|| format!("{name}: cannot be run"))?;
    if !output.status.success() {
        eprint!("{}", String::from_utf8_lossy(&output.stderr));
        bail!(
            Other,
            "{name} {} {program}: failed ({})",
            machine.name(),
            output.status
        );
    }
    let said = String::from_utf8_lossy(&output.stdout);
    let folder = said.lines().last().unwrap_or_default();
    let image = Path::new(folder).join(program);
    if !image.is_file() {
        bail!(Other, "{}: {name} did not build it", image.display());
    }
    Ok(image)
}

/// Memory that an image occupies on a microcontroller.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ImageSizes {
    /// Bytes of code, constants and initial values of variables.
    pub flash_bytes: u64,
    /// Bytes of static variables, without the stack.
    pub ram_bytes: u64,
}

impl ImageSizes {
    /// Returns the sizes of an ELF file's sections: allocated sections with contents count as flash, writable ones as
    /// RAM.
    ///
    /// # Errors
    /// A file that is not a 32-bit ELF file.
    pub fn of(image: &[u8]) -> Result<Self> {
        let file: ElfFile32 = ElfFile32::parse(image).context("not a 32-bit ELF image")?;
        let mut sizes = Self::default();
        for section in file.sections() {
            let SectionFlags::Elf {
                sh_type, sh_flags, ..
            } = section.flags()
            else {
                continue;
            };
            let has = |flag: elf::SectionFlags| sh_flags & flag == flag;
            // This also skips defmt's strings, which stay on the host.
            if !has(elf::SHF_ALLOC) {
                continue;
            }
            if sh_type != elf::SHT_NOBITS {
                sizes.flash_bytes += section.size();
            }
            if has(elf::SHF_WRITE) {
                sizes.ram_bytes += section.size();
            }
        }
        Ok(sizes)
    }

    /// Reads a file and returns its sizes, see [`ImageSizes::of`].
    ///
    /// # Errors
    /// A file that cannot be read or is not a 32-bit ELF file.
    pub fn read(path: &Path) -> Result<Self> {
        let name = path.display();
        let image = small_file::read(path, BYTES_MAX)?;
        Self::of(&image).with_context(|| format!("{name}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns an ELF file with the given sections (type, flags, size), which all share the same bytes.
    fn elf_file(sections: &[(elf::SectionType, elf::SectionFlags, u32)]) -> Vec<u8> {
        const HEADER: u32 = 52;
        let mut file = b"\x7FELF\x01\x01\x01".to_vec();
        file.resize(16, 0);
        let largest = sections.iter().map(|(_, _, size)| *size).fold(4, u32::max);
        let halves = |file: &mut Vec<u8>, halves: &[u16]| {
            file.extend(halves.iter().flat_map(|half| half.to_le_bytes()));
        };
        let words = |file: &mut Vec<u8>, words: &[u32]| {
            file.extend(words.iter().flat_map(|word| word.to_le_bytes()));
        };
        // An executable for ARM; the section headers follow after as many bytes as the largest section has.
        halves(&mut file, &[elf::ET_EXEC.0, elf::EM_ARM.0]);
        words(&mut file, &[1, 0, 0, HEADER + largest, 0]);
        let names = sections.len() as u16 + 1;
        halves(&mut file, &[HEADER as u16, 0, 0, 40, names + 1, names]);
        file.resize((HEADER + largest + 40) as usize, 0);
        let names = (elf::SHT_STRTAB, elf::SectionFlags(0), 1);
        for (kind, flags, size) in sections.iter().chain([&names]) {
            words(
                &mut file,
                &[0, kind.0, flags.0 as u32, 0, HEADER, *size, 0, 0, 4, 0],
            );
        }
        file
    }

    #[test]
    fn sections_are_counted_where_they_lie() {
        use elf::{SHF_ALLOC, SHF_EXECINSTR, SHF_WRITE, SHT_NOBITS, SHT_PROGBITS};
        let file = elf_file(&[
            (SHT_PROGBITS, SHF_ALLOC, 392),
            (SHT_PROGBITS, SHF_ALLOC | SHF_EXECINSTR, 5000),
            (SHT_PROGBITS, SHF_ALLOC | SHF_WRITE, 70),
            (SHT_NOBITS, SHF_ALLOC | SHF_WRITE, 100_000),
            // The strings of defmt, and debug information.
            (SHT_PROGBITS, elf::SectionFlags(0), 900),
        ]);
        let sizes = ImageSizes {
            flash_bytes: 392 + 5000 + 70,
            ram_bytes: 70 + 100_000,
        };
        assert_eq!(ImageSizes::of(&file).unwrap(), sizes);
        assert_eq!(
            ImageSizes::of(&elf_file(&[])).unwrap(),
            ImageSizes::default()
        );
    }

    #[test]
    fn damaged_images_are_refused_or_counted() {
        let file = elf_file(&[(elf::SHT_PROGBITS, elf::SHF_ALLOC, 30)]);
        assert!(ImageSizes::of(b"").is_err());
        for end in 0..file.len() {
            let _ = ImageSizes::of(&file[..end]);
            for bit in 0..8 {
                let mut file = file.clone();
                file[end] ^= 1 << bit;
                let _ = ImageSizes::of(&file);
            }
        }
    }
}
