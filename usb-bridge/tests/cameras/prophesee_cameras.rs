//! Prophesee's models against their simulated cameras: found, identified, started, read, stopped.

use std::time::Duration;

use anyhow::Result;
use eecvs_nostd::{Event, Polarity, Sensor};
use usb_bridge::device::prophesee::{
    EVK, EVK2, EVK3_GENX320, EVK3_HD, EVK4_EVT21, Prophesee, treuzell,
};
use usb_bridge::device::{Due, Model, Stream, find, recognise};
use usb_bridge::link::LinkError;
use usb_bridge::link::control::{Control, Request};
use usb_bridge::peripheral::{Bulk, Peripheral, Reply};

/// The control side of a simulated camera, without a bus.
struct Direct<'p> {
    camera: &'p mut dyn Peripheral,
    waited: Duration,
}

impl<'p> Direct<'p> {
    fn new(camera: &'p mut dyn Peripheral) -> Self {
        Self {
            camera,
            waited: Duration::ZERO,
        }
    }

    fn refused(endpoint: u8) -> LinkError {
        LinkError::Stalled {
            link: "simulated".to_owned(),
            endpoint,
        }
    }
}

impl Control for Direct<'_> {
    fn control_out(&mut self, request: Request, data: &[u8]) -> Result<(), LinkError> {
        match self.camera.control(request, data, 0) {
            Reply::Data(_) => Ok(()),
            Reply::Stall => Err(Self::refused(0)),
        }
    }

    fn control_in(&mut self, request: Request, data: &mut [u8]) -> Result<usize, LinkError> {
        match self.camera.control(request, &[], data.len()) {
            Reply::Data(answer) => {
                data[..answer.len()].copy_from_slice(&answer);
                Ok(answer.len())
            }
            Reply::Stall => Err(Self::refused(0)),
        }
    }

    fn bulk_out(&mut self, endpoint: u8, data: &[u8]) -> Result<(), LinkError> {
        if self.camera.bulk_out(endpoint, data) {
            Ok(())
        } else {
            Err(Self::refused(endpoint))
        }
    }

    fn bulk_in(&mut self, endpoint: u8, data: &mut [u8]) -> Result<usize, LinkError> {
        let mut bytes = Vec::new();
        match self.camera.bulk_in(endpoint, data.len(), &mut bytes) {
            Bulk::Data => {
                data[..bytes.len()].copy_from_slice(&bytes);
                Ok(bytes.len())
            }
            Bulk::Wait | Bulk::Stall => Err(Self::refused(endpoint)),
        }
    }

    fn clear_halt(&mut self, endpoint: u8) -> Result<(), LinkError> {
        self.camera.clear_halt(endpoint);
        Ok(())
    }

    fn wait(&mut self, duration: Duration) {
        self.waited += duration;
    }

    fn release(&self) -> u16 {
        0
    }

    fn serial(&mut self) -> Option<String> {
        None
    }

    fn name(&self) -> &str {
        "simulated"
    }
}

/// Bytes that are all due.
struct Ready(Vec<u8>);

impl Stream for Ready {
    fn take(&mut self, room: usize, bytes: &mut Vec<u8>) -> Result<Due> {
        bytes.extend(self.0.drain(..room.min(self.0.len())));
        Ok(if self.0.is_empty() {
            Due::Ended
        } else {
            Due::More
        })
    }
}

fn events(sensor: Sensor) -> Vec<Event> {
    let event = |at: u16| Event {
        t_us: u64::from(at) * 37,
        x: at * 7 % sensor.width,
        y: at * 3 % sensor.height,
        polarity: Polarity::from_bool(at.is_multiple_of(2)),
    };
    (0..5000).map(event).collect()
}

fn session(model: &Prophesee, name: &str, stream: &str, sensor: (u16, u16)) {
    let sensor = Sensor::new(sensor.0, sensor.1).unwrap();
    let events = events(sensor);
    let mut bytes = Vec::new();
    let mut writer = model.writer(sensor).expect("its own sensor");
    writer.write(&events, &mut bytes).unwrap();
    writer.finish(&mut bytes).unwrap();
    let mut camera = model.camera(sensor, Box::new(Ready(bytes))).unwrap();
    // As a host does: by what the device says of itself on the bus.
    let device = camera.descriptors().device.clone();
    let word = |at: usize| u16::from_le_bytes([device[at], device[at + 1]]);
    let found = recognise(word(8), word(10), word(12)).expect("a known model");
    let info = found.identify(&mut Direct::new(camera.as_mut())).unwrap();
    assert_eq!(
        (info.name.as_str(), info.stream, info.sensor),
        (name, stream, sensor)
    );
    assert_eq!(info.serial.as_deref(), Some("00050567"));
    assert_eq!(info.firmware, "3.9.0");
    let mut data = Vec::new();
    let endpoint = found.transfers().endpoint;
    assert_eq!(camera.bulk_in(endpoint, 1000, &mut data), Bulk::Wait);
    let mut control = Direct::new(camera.as_mut());
    found.start(&info, &mut control).unwrap();
    let (mut parser, mut parsed) = (found.parser(&info), Vec::new());
    for turn in 0.. {
        data.clear();
        if camera.bulk_in(endpoint, 1000, &mut data) == Bulk::Wait {
            break;
        }
        parser.parse(&data, &mut parsed);
        if turn == 3 {
            // Stopped, silent, started again.
            found
                .stop(&info, &mut Direct::new(camera.as_mut()))
                .unwrap();
            data.clear();
            assert_eq!(camera.bulk_in(endpoint, 1000, &mut data), Bulk::Wait);
            found
                .start(&info, &mut Direct::new(camera.as_mut()))
                .unwrap();
        }
    }
    assert!(parsed == events, "{name}");
    assert_eq!(parser.losses().iter().count(), 0);
}

#[test]
fn every_model_is_found_started_and_read() {
    session(&EVK, "EVK4 IMX636", "evt3", (1280, 720));
    session(&EVK4_EVT21, "EVK4 IMX636", "evt21-upper-first", (1280, 720));
    session(&EVK3_HD, "EVK3-HD Gen 4.1", "evt3", (1280, 720));
    session(&EVK3_GENX320, "EVK3 GenX320", "evt21", (320, 320));
    session(&EVK2, "EVK2 IMX636", "evt3", (1280, 720));
}

#[test]
fn sensors_that_do_not_fit_are_refused() {
    let large = Sensor::new(1280, 721).unwrap();
    assert!(EVK.writer(large).is_none());
    assert!(
        EVK3_GENX320
            .camera(large, Box::new(Ready(vec![])))
            .is_none()
    );
    assert!(
        find("evk4").is_some_and(|model| model.writer(Sensor::new(346, 260).unwrap()).is_some())
    );
}

#[test]
fn boards_that_answer_nonsense_are_refused_in_one_line() {
    /// A board that answers every question with the same bytes.
    struct Nonsense(Vec<u8>);
    impl Peripheral for Nonsense {
        fn descriptors(&self) -> &usb_bridge::peripheral::Descriptors {
            unreachable!("nobody asks")
        }
        fn control(&mut self, _: Request, _: &[u8], _: usize) -> Reply {
            Reply::Stall
        }
        fn bulk_out(&mut self, _: u8, _: &[u8]) -> bool {
            true
        }
        fn bulk_in(&mut self, _: u8, room: usize, data: &mut Vec<u8>) -> Bulk {
            data.extend(self.0.iter().take(room));
            Bulk::Data
        }
        fn clear_halt(&mut self, _: u8) {}
        fn reset(&mut self) {}
    }
    for (answer, says) in [
        (vec![], "not a valid frame"),
        (vec![1, 2, 3], "not a valid frame"),
        (
            treuzell::frame(treuzell::FAILED, &[]),
            "update the firmware",
        ),
        (
            treuzell::frame(treuzell::RELEASE | treuzell::FAILED, &[5, 0, 0, 0]),
            "(error 5)",
        ),
        (
            treuzell::frame(treuzell::RELEASE | treuzell::FAILED, &[]),
            "failed",
        ),
        (treuzell::frame(treuzell::RELEASE, &[]), "too short"),
        (treuzell::frame(treuzell::RELEASE, &[0; 4]), "reconnect"),
        (vec![0xff; 4000], "not a valid frame"),
    ] {
        let mut board = Nonsense(answer);
        let error = EVK.identify(&mut Direct::new(&mut board)).unwrap_err();
        let error = format!("{error:#}");
        assert!(error.contains(says) && !error.contains('\n'), "{error}");
    }
}

proptest::proptest! {
    /// Whatever a host sends, the camera answers every question, and never more than it may.
    #[test]
    fn any_questions_are_survived(
        questions in proptest::collection::vec(
            (proptest::prelude::any::<bool>(), proptest::collection::vec(proptest::prelude::any::<u8>(), 0..40)), 0..40),
    ) {
        let mut camera = EVK2.camera(Sensor::new(100, 100).unwrap(), Box::new(Ready(vec![1; 100]))).unwrap();
        for (known, mut question) in questions {
            if known && question.len() > 8 {
                let property = [treuzell::REGISTERS, treuzell::REGISTERS | treuzell::WRITE, treuzell::COMPATIBLE, treuzell::STREAM | treuzell::WRITE];
                question = treuzell::frame(property[usize::from(question[0]) % 4], &question[8..]);
            }
            proptest::prop_assert!(camera.bulk_out(treuzell::OUT, &question));
            let mut answer = Vec::new();
            proptest::prop_assert_eq!(camera.bulk_in(treuzell::IN, 1024, &mut answer), Bulk::Data);
            proptest::prop_assert!(answer.len() <= 1024 && treuzell::parse(&answer).is_some());
            proptest::prop_assert_eq!(camera.bulk_in(treuzell::IN, 1024, &mut answer), Bulk::Wait);
        }
    }
}
