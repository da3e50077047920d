//! Receives any bytes on the event link: no panic, packets stay within their bounds, words decode or are skipped.

use eecvs_nostd::event_link::{BODY_BYTES_MAX, HotNumbers, Kind, Receiver, Setup};
use eecvs_nostd::evt2::Evt2Decoder;

/// Runs one input.
pub fn run(data: &[u8]) {
    let mut receiver = Receiver::new();
    let mut decoder = Evt2Decoder::new(0);
    for byte in data {
        let Some(packet) = receiver.push(*byte) else {
            continue;
        };
        assert!(packet.body.len() <= BODY_BYTES_MAX);
        match packet.kind {
            Kind::Setup => {
                if let Some(setup) = Setup::parse(packet.body) {
                    decoder = Evt2Decoder::new(setup.time_base_us);
                    let _ = setup.config();
                }
            }
            Kind::Words => {
                for word in packet.body.chunks_exact(4) {
                    decoder.decode(u32::from_le_bytes([word[0], word[1], word[2], word[3]]));
                }
            }
            Kind::Hot => {
                let mut numbers = HotNumbers::START;
                while numbers.read(packet.body).is_some() {}
                assert!(numbers.bytes() <= packet.body.len());
            }
            Kind::Flush | Kind::Status => {}
        }
    }
    assert!(receiver.damaged_bytes() as usize <= data.len());
}
