//! Pixels of frames whose coefficients an adaptive coder has coded.

use eecvs_nostd::coder::coefficients::pixel::{Common, Pixel as Told};
use eecvs_nostd::coder::coefficients::{CoefficientMemory, dense, fast};
use eecvs_nostd::coder::dense::{Dense, DenseMemory};
use eecvs_nostd::coder::range::RangeDecoder;
use eecvs_nostd::{Coder, Descriptor, Frame};

use super::Pixel;
use super::hybrid::{Chain, Refused};

/// Decodes such frames in the order in which they come.
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
    /// A frame's pixels, in raster order.
    ///
    /// # Errors
    /// [`Refused`]; nothing of the frame is returned then.
    pub fn frame(&mut self, frame: &Frame<'_>, coder: Coder) -> Result<Vec<Pixel>, Refused> {
        let mut pixels = Vec::new();
        self.descriptors(frame, coder, |descriptor| {
            pixels.push(Pixel::dequantise(&frame.header, &descriptor));
        })?;
        Ok(pixels)
    }

    /// The same as the plain payload has them, handed to `each` as they are found.
    ///
    /// # Errors
    /// [`Refused`], where what was handed on does not count.
    pub fn descriptors(
        &mut self,
        frame: &Frame<'_>,
        coder: Coder,
        mut each: impl FnMut(Descriptor),
    ) -> Result<(), Refused> {
        let header = &frame.header;
        let common = Common::new(header.packing(), header.duration_us);
        let counts = (header.events, header.pixels);
        let each = |pixel: &Told, common: &Common| each(pixel.descriptor(common));
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
        // An encoder that ran out of room has written more than what counts.
        if header.last && !reader.is_spent() {
            return Err(Refused::Malformed);
        }
        chain.next = header.sequence.wrapping_add(1);
        self.chain = Some(chain);
        Ok(())
    }
}
