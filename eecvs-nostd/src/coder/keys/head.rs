//! The header of a slice.

use crate::coder::keys::bits::{Reader, Writer};
use crate::coder::keys::code::{CONTEXTS, Code, describe, read};
use crate::coder::keys::kernels::Span;
use crate::coder::keys::preset::preset;
use crate::coder::keys::{SLICE_EVENTS, Window};

/// Sections of symbols in a slice of [`SECTIONED`] events and more.
pub const SECTIONS: usize = 4;
/// Fewer events have a single section.
pub const SECTIONED: usize = 1024;

/// Returns the number of sections of a slice.
pub const fn sections(events: usize) -> usize {
    if events < SECTIONED { 1 } else { SECTIONS }
}

/// Returns the first event of a section.
pub const fn section_start(events: usize, section: usize) -> usize {
    events * section / sections(events)
}

/// Bits of the first byte: the slice tells its times; it has two contexts.
const TIMES: u8 = 1;
const SPLIT: u8 = 2;
/// Bit of the first byte: the code is the preset one, and the only section is as long as its symbols.
const PRESET: u8 = 4;

/// The codes of a slice.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Model {
    /// A code for each context.
    pub codes: [Code; CONTEXTS],
    /// Number of contexts, 1 or 2.
    pub contexts: usize,
    /// First class after which the second context holds.
    pub split: u8,
    /// Whether the code is the preset one, of a slice with one section.
    pub is_preset: bool,
}

impl Model {
    /// No code yet.
    pub const NONE: Self = Self {
        codes: [Code::NONE; CONTEXTS],
        contexts: 0,
        split: 0,
        is_preset: false,
    };
}

/// What precedes the symbols of a slice, besides its codes.
#[derive(Debug, Clone, Copy)]
pub struct Head {
    /// First unit of time.
    pub first: u32,
    /// Number of units of time, at least 1.
    pub units: u32,
    /// Whether the header has them: else they are all of the window's.
    pub tells_times: bool,
    /// Size of each section of symbols; none with the preset code.
    pub sections: [u16; SECTIONS],
}

impl Head {
    /// Writes the header and the codes of a slice of `events`; `last` is the last unit of the slice before, or 0. Returns
    /// their size, whether or not there was room.
    pub fn write(&self, events: usize, last: u32, model: &Model, out: &mut [u8]) -> usize {
        let mut writer = Writer::new(out);
        let mut flags = 0;
        flags |= if self.tells_times { TIMES } else { 0 };
        flags |= if model.contexts > 1 { SPLIT } else { 0 };
        flags |= if model.is_preset { PRESET } else { 0 };
        writer.byte(flags);
        if self.tells_times {
            writer.varint(self.first - last);
            writer.varint(self.units - 1);
        }
        if model.is_preset {
            return writer.bytes();
        }
        for size in &self.sections[..sections(events)] {
            writer.byte(*size as u8);
            writer.byte((size >> 8) as u8);
        }
        if model.contexts > 1 {
            writer.bits(u32::from(model.split), 6);
        }
        for code in &model.codes[..model.contexts] {
            describe(code, &mut writer);
        }
        writer.align();
        writer.bytes()
    }

    /// Writes the sections' sizes into a header without the preset code that is there already.
    pub fn patch(&self, events: usize, last: u32, out: &mut [u8]) {
        let mut writer = Writer::new(&mut []);
        if self.tells_times {
            writer.varint(self.first - last);
            writer.varint(self.units - 1);
        }
        let at = 1 + writer.bytes();
        for (size, two) in self.sections[..sections(events)]
            .iter()
            .zip(out[at..].as_chunks_mut::<2>().0)
        {
            *two = size.to_le_bytes();
        }
    }

    /// Reads the header and the codes of a slice of `events`, at `at`; returns the header and the place after it. `last` is
    /// the last unit of the slice before.
    pub fn read(
        payload: &[u8],
        at: usize,
        events: usize,
        window: &Window,
        last: Option<u32>,
        model: &mut Model,
    ) -> Option<(Self, usize)> {
        let mut reader = Reader::new(payload, at);
        let flags = reader.byte()?;
        if flags & !(TIMES | SPLIT | PRESET) != 0 || events == 0 || events > SLICE_EVENTS {
            return None;
        }
        let all = window.cells.count();
        let tells_times = flags & TIMES != 0;
        let (first, units) = if tells_times {
            let first = last.unwrap_or(0).checked_add(reader.varint()?)?;
            let units = reader.varint()?.checked_add(1)?;
            if first.checked_add(units - 1)? >= all {
                return None;
            }
            (first, units)
        } else if last.is_none() {
            (0, all)
        } else {
            return None;
        };
        let span = Span::new(window, units);
        let mut sizes = [0; SECTIONS];
        if flags & PRESET != 0 {
            if flags & SPLIT != 0 || sections(events) != 1 {
                return None;
            }
            *model = Model {
                contexts: 1,
                is_preset: true,
                ..Model::NONE
            };
            model.codes[0] = preset(&span, events);
            let head = Self {
                first,
                units,
                tells_times,
                sections: sizes,
            };
            return Some((head, reader.at()));
        }
        model.is_preset = false;
        for size in &mut sizes[..sections(events)] {
            *size = u16::from_le_bytes([reader.byte()?, reader.byte()?]);
        }
        let highest = span.highest();
        model.contexts = if flags & SPLIT != 0 { 2 } else { 1 };
        model.split = if flags & SPLIT != 0 {
            reader.bits(6)? as u8
        } else {
            0
        };
        for code in &mut model.codes[..model.contexts] {
            *code = read(&mut reader, highest)?;
        }
        reader.align()?;
        let head = Self {
            first,
            units,
            tells_times,
            sections: sizes,
        };
        Some((head, reader.at()))
    }
}
