//! Decodes frames whose coefficients are coded by an adaptive coder.

use eecvs_nostd::coder::coefficients::pixel::{Common, Pixel as Told};
use eecvs_nostd::coder::coefficients::{CoefficientMemory, dense, fast};
use eecvs_nostd::coder::dense::{Dense, DenseMemory};
use eecvs_nostd::coder::range::{InputLeft, RangeDecoder};
use eecvs_nostd::{Coder, Descriptor, Frame};

use super::Pixel;
use super::hybrid::{Chain, Refused};

/// Decodes frames of adaptively coded coefficients, in the order in which they arrive.
#[derive(Debug)]
pub struct CoefficientDecoder {
    chain: Option<Chain>,
    memory: Box<CoefficientMemory>,
}

impl Default for CoefficientDecoder {
    fn default() -> Self {
        Self {
            chain: None,
            memory: Box::new(CoefficientMemory::UNSET),
        }
    }
}

impl CoefficientDecoder {
    /// Decodes a frame's pixels, in raster order.
    ///
    /// # Errors
    /// [`Refused`] if the frame does not decode; none of its pixels is returned then.
    pub fn frame(&mut self, frame: &Frame<'_>, coder: Coder) -> Result<Vec<Pixel>, Refused> {
        let mut pixels = Vec::new();
        self.descriptors(frame, coder, |descriptor| {
            pixels.push(Pixel::dequantise(&frame.header, &descriptor));
        })?;
        Ok(pixels)
    }

    /// Decodes a frame to the descriptors that a plain payload would carry, and calls `each` with each of them.
    ///
    /// # Errors
    /// [`Refused`] if the frame does not decode; the descriptors passed to `each` until then are invalid.
    pub fn descriptors(
        &mut self,
        frame: &Frame<'_>,
        coder: Coder,
        mut each: impl FnMut(Descriptor),
    ) -> Result<(), Refused> {
        self.descriptors_and_left(frame, coder, |descriptor, _| each(descriptor))
    }

    /// Does the same, and tells `each` what is left of the payload after a pixel.
    pub(super) fn descriptors_and_left(
        &mut self,
        frame: &Frame<'_>,
        coder: Coder,
        mut each: impl FnMut(Descriptor, InputLeft),
    ) -> Result<(), Refused> {
        let header = &frame.header;
        let common = Common::new(header.packing(), header.duration_us);
        let counts = (header.events, header.pixels);
        let each = |pixel: &Told, common: &Common, left: InputLeft| {
            each(pixel.descriptor(common), left);
        };
        if coder == Coder::Fast {
            let read = fast::read(&mut self.memory, &common, counts, frame.payload, each);
            return read.map_err(|_| Refused::Malformed);
        }
        let mut chain = Chain::of(self.chain.take(), header)?;
        let mut lent = DenseMemory {
            model: &mut chain.model,
            words: &mut chain.words,
        };
        let mut walk = Dense::with_previous(header.sensor, header.has_previous, &mut lent)
            .ok_or(Refused::Malformed)?;
        if header.is_key {
            walk.restart();
            self.memory.restart();
        }
        let mut reader = RangeDecoder::new(frame.payload);
        dense::read(
            &mut walk,
            &mut self.memory,
            &common,
            counts,
            &mut reader,
            each,
        )
        .map_err(|_| Refused::Malformed)?;
        // A frame that was cut short for lack of room may have bytes that do not count at its end; the last frame
        // of a window may not.
        if header.last && !reader.is_spent() {
            return Err(Refused::Malformed);
        }
        chain.next = header.sequence.wrapping_add(1);
        self.chain = Some(chain);
        Ok(())
    }
}
