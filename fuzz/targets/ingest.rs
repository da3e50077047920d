//! Feeds packets with any words, damaged or not, to the ingest of an encoding side that is fast or slow: no panic,
//! no deadlock, and the counts add up.

use std::collections::VecDeque;

use eecvs_nostd::event_link::{
    BODY_BYTES_MAX, FIELDS_BYTES_MAX, Kind, PACKET_BYTES_MAX, Packet, Setup,
};
use eecvs_nostd::fixed_point::{Sum, WideSum};
use eecvs_nostd::ingest::from_link::Link;
use eecvs_nostd::ingest::{Exchange, Ingest, Poll, Work};
use eecvs_nostd::{
    Config, Filter, Frame, KEY_WINDOWS, Mode, OUTPUT_BYTES_MIN, Quantiser, Scratch, Sensor,
    Thresholds, Window, WindowBuffers, WindowConfig, WindowEncoder,
};

const CONFIG: WindowConfig = WindowConfig::new(
    Sensor {
        width: 70,
        height: 9,
    },
    1000,
);

#[derive(Default)]
struct Side<'b> {
    free: VecDeque<Window<'b>>,
    work: VecDeque<Work<'b>>,
}

impl<'b> Exchange<'b> for Side<'b> {
    fn free(&mut self) -> Option<Window<'b>> {
        self.free.pop_front()
    }

    fn has_room(&self) -> bool {
        self.work.len() < 2
    }

    fn hand_over(&mut self, work: Work<'b>) {
        self.work.push_back(work);
    }
}

struct Machine<'b> {
    link: Link,
    ingest: Ingest<'b>,
    side: Side<'b>,
    encoder: WindowEncoder<'b>,
    /// Memory of the windows, lent once.
    buffers: Vec<WindowBuffers<'b>>,
    /// Number of events in windows.
    encoded: u64,
}

impl<'b> Machine<'b> {
    /// Does one piece of the encoding side's work; returns `false` if there is none.
    fn work(&mut self) -> bool {
        match self.side.work.pop_front() {
            None => return false,
            Some(Work::Setup(setup, _)) => {
                // Later setups are refused.
                let windows: Vec<_> = self.buffers.drain(..).collect();
                let count = windows.len();
                for buffers in windows {
                    let window = Window::new(CONFIG, buffers).expect("room for both");
                    self.side.free.push_back(window);
                }
                self.ingest.set_up(&setup, count);
            }
            Some(Work::Window(mut window)) => {
                self.encoded += u64::from(window.events());
                let mut out = [0; OUTPUT_BYTES_MIN];
                while let Some(frame) = self
                    .encoder
                    .next_frame(&mut window, &mut out)
                    .expect("room for a frame")
                {
                    Frame::parse(&out[frame.range]).expect("a whole frame");
                }
                self.side.free.push_back(window);
            }
            Some(Work::Hot(number)) => {
                let (x, y) = (number % 70, number / 70);
                let _ = self.encoder.add_hot((x as u16, y.min(9) as u16));
            }
            Some(Work::HotEnd(_)) => {}
            Some(Work::Flush(counts)) => {
                assert!(self.encoded <= u64::from(counts.events));
            }
        }
        true
    }

    fn receive(&mut self, bytes: &[u8]) {
        let mut bytes = bytes.iter().copied();
        loop {
            let mut source = self.link.source(|| bytes.next());
            if self.ingest.poll(&mut source, &mut self.side) == Poll::Idle {
                break;
            }
            assert!(self.work(), "stalled without work to do");
        }
    }
}

/// Runs one input.
pub fn run(data: &[u8]) {
    let mut memory = vec![0; 2 * 120];
    let buffers = WindowBuffers::share(&mut memory, 2, &CONFIG).expect("room for both");
    let (mut sums, mut totals) = ([Sum::ZERO; 32], [WideSum::ZERO; 32]);
    let mut magnitudes = [0; 32];
    let scratch = Scratch {
        sums: &mut sums,
        totals: &mut totals,
        magnitudes: &mut magnitudes,
        dense: None,
        tree: None,
        keys: None,
        coefficients: None,
        hot: &mut [0; 20],
        order: &mut [],
    };
    let config = Config {
        window: CONFIG,
        thresholds: Thresholds::new(1 << 40, 1 << 43).expect("in order"),
        transform: None,
        m: 8,
        grid: None,
        quantiser: Quantiser::DEFAULT,
        few_as_times: false,
        max_emd_us: None,
        mode: Mode::Transform,
        key_windows: KEY_WINDOWS,
        readout: None,
        filter: Filter::NONE,
        bytes_per_second: None,
        keep_order: false,
    };
    let mut machine = Machine {
        link: Link::new(),
        ingest: Ingest::new(),
        side: Side::default(),
        encoder: WindowEncoder::new(config, scratch).expect("a valid configuration"),
        buffers: buffers.collect(),
        encoded: 0,
    };
    let mut rest = data;
    while let [operation, len, tail @ ..] = rest {
        let len = usize::from(*len).min(tail.len());
        let (body, tail) = tail.split_at(len);
        rest = tail;
        let kind = match operation % 8 {
            0 => Kind::Setup,
            1 => Kind::Flush,
            2..5 => Kind::Words,
            5 => Kind::Hot,
            _ => Kind::Status,
        };
        let mut setup = [0; FIELDS_BYTES_MAX];
        let body = if kind == Kind::Setup {
            let len = Setup {
                width: 70,
                height: 9,
                window_us: 1000,
                tau_low_pico: 0,
                tau_high_pico: 0,
                transform: 0,
                m: 8,
                grid: 0,
                step_log2: 0,
                mode: 0,
                fidelity: 0,
                key_windows: 1,
                region: [0, 0, u16::from(operation / 16), 5],
                options: operation / 16 % 4,
                bytes_per_second: 0,
                scan_period_q16: u32::from(*operation) << 16,
                scan_slope_q16: 0,
                scan_axis: operation / 16 % 4,
                time_base_us: 0,
                when_full: operation / 8 % 2,
            }
            .write(&mut setup)
            .expect("enough room");
            &setup[..len]
        } else {
            &body[..len.min(BODY_BYTES_MAX)]
        };
        let mut bytes = [0; PACKET_BYTES_MAX];
        let position = u32::from(operation / 16);
        let mut len = Packet {
            kind,
            position,
            body,
        }
        .write(&mut bytes)
        .expect("room for the longest");
        if operation % 8 == 7 {
            // Garbage, or a truncated packet.
            len /= 2;
        }
        machine.receive(&bytes[..len]);
        if operation % 3 == 0 {
            machine.work();
        }
    }
    while machine.work() {
        machine.receive(&[]);
    }
}
