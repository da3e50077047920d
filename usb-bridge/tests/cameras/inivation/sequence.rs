//! Drivers against simulated cameras: identify, start, stream, stop, reset.

use std::time::Duration;

use usb_bridge::device::{Due, Info, Stream, recognise};
use usb_bridge::link::LinkError;
use usb_bridge::link::control::{Control, Request};
use usb_bridge::peripheral::{Bulk, Peripheral, Reply};

use super::scene::{MODELS, model, scene, sensor, sorted_frames, write};

/// A camera on a very short cable.
struct Cable {
    camera: Box<dyn Peripheral>,
    release: u16,
    refuse: Option<u8>,
    halts_cleared: Vec<u8>,
    waited: Duration,
}

impl Cable {
    fn new(camera: Box<dyn Peripheral>) -> Self {
        let device = &camera.descriptors().device;
        Self {
            release: u16::from_le_bytes([device[12], device[13]]),
            camera,
            refuse: None,
            halts_cleared: Vec::new(),
            waited: Duration::ZERO,
        }
    }

    fn ask(&mut self, request: Request, data: &[u8], length: usize) -> Result<Vec<u8>, LinkError> {
        let refused = self.refuse == Some(request.request);
        match self.camera.control(request, data, length) {
            Reply::Data(data) if !refused => Ok(data),
            _ => Err(LinkError::Stalled {
                link: self.name().into(),
                endpoint: 0,
            }),
        }
    }

    /// Transfers of `room` bytes until the camera waits.
    fn drain(&mut self, endpoint: u8, room: usize) -> Vec<u8> {
        let mut all = Vec::new();
        loop {
            let mut data = Vec::new();
            match self.camera.bulk_in(endpoint, room, &mut data) {
                Bulk::Data => assert!(!data.is_empty() && data.len() <= room),
                Bulk::Wait => return all,
                Bulk::Stall => panic!("halted"),
            }
            all.append(&mut data);
        }
    }
}

impl Control for Cable {
    fn control_out(&mut self, request: Request, data: &[u8]) -> Result<(), LinkError> {
        assert!(!request.is_in());
        self.ask(request, data, 0).map(|_| ())
    }

    fn control_in(&mut self, request: Request, data: &mut [u8]) -> Result<usize, LinkError> {
        assert!(request.is_in());
        let answer = self.ask(request, &[], data.len())?;
        data[..answer.len()].copy_from_slice(&answer);
        Ok(answer.len())
    }

    fn bulk_out(&mut self, _: u8, _: &[u8]) -> Result<(), LinkError> {
        unreachable!("no endpoint of commands")
    }

    fn bulk_in(&mut self, _: u8, _: &mut [u8]) -> Result<usize, LinkError> {
        unreachable!("no endpoint of commands")
    }

    fn clear_halt(&mut self, endpoint: u8) -> Result<(), LinkError> {
        self.camera.clear_halt(endpoint);
        self.halts_cleared.push(endpoint);
        Ok(())
    }

    fn wait(&mut self, duration: Duration) {
        self.waited += duration;
    }

    fn release(&self) -> u16 {
        self.release
    }

    fn serial(&mut self) -> Option<String> {
        self.camera.descriptors().strings.get(2).cloned()
    }

    fn name(&self) -> &str {
        "cable"
    }
}

/// Bytes of which some are due at a time.
struct Bytes(Vec<u8>, usize);

impl Stream for Bytes {
    fn take(&mut self, room: usize, bytes: &mut Vec<u8>) -> anyhow::Result<Due> {
        let rest = &self.0[self.1..];
        let some = rest.len().min(room).min(1000);
        bytes.extend(&rest[..some]);
        self.1 += some;
        let ended = self.1 == self.0.len();
        Ok(if ended { Due::Ended } else { Due::More })
    }
}

/// A recording that breaks off.
struct Broken;

impl Stream for Broken {
    fn take(&mut self, _: usize, _: &mut Vec<u8>) -> anyhow::Result<Due> {
        anyhow::bail!("cannot be read")
    }
}

fn identify(name: &str, cable: &mut Cable) -> Info {
    let info = model(name).identify(cable).expect("it answers");
    assert_eq!(info.serial.as_deref(), Some("00000001"));
    assert!(info.firmware.starts_with("firmware "));
    info
}

#[test]
fn a_camera_sends_its_events_from_start_to_stop() {
    for (name, width, height) in MODELS {
        let size = sensor(width, height);
        let events = scene(size, 5000, 23);
        let bytes = write(name, size, &events);
        let model = model(name);
        let stream = Box::new(Bytes(bytes.clone(), 0));
        let mut cable = Cable::new(model.camera(size, stream).expect("it fits"));
        let device = cable.camera.descriptors().device.clone();
        let id = |at| u16::from_le_bytes([device[at], device[at + 1]]);
        let found = recognise(id(8), id(10), cable.release).expect("a known device");
        assert_eq!(found.name(), name);

        let endpoint = model.transfers().endpoint;
        let configuration = &cable.camera.descriptors().configuration;
        assert!(
            configuration
                .windows(4)
                .any(|four| four == [7, 5, endpoint, 2])
        );

        // It is silent until it is started.
        assert!(cable.drain(endpoint, 512).is_empty());
        let info = identify(name, &mut cable);
        assert_eq!(info.sensor, size, "{name}");
        assert_eq!(cable.halts_cleared, [endpoint]);
        assert!(cable.drain(endpoint, 512).is_empty());

        model.start(&info, &mut cable).expect("it starts");
        let mut sent = Vec::new();
        assert_eq!(cable.camera.bulk_in(endpoint, 512, &mut sent), Bulk::Data);
        // Stopped, it keeps the rest; a reset stops it too.
        model.stop(&info, &mut cable).expect("it stops");
        assert!(cable.drain(endpoint, 512).is_empty());
        model.start(&info, &mut cable).expect("it starts");
        cable.camera.reset();
        assert!(cable.drain(endpoint, 512).is_empty());

        let info = identify(name, &mut cable);
        model.start(&info, &mut cable).expect("it starts");
        sent.extend(cable.drain(endpoint, 8192));
        assert_eq!(sent, bytes);
        let mut parser = model.parser(&info);
        let mut read = Vec::new();
        parser.parse(&sent, &mut read);
        assert_eq!(parser.losses().iter().count(), 0);
        assert_eq!(parser.sensor(), size);
        assert!(read == sorted_frames(name, events));
        model.stop(&info, &mut cable).expect("it stops");
    }
}

#[test]
fn a_request_that_is_refused_is_named() {
    for (name, width, height) in MODELS {
        let size = sensor(width, height);
        let camera = || model(name).camera(size, Box::new(Broken)).expect("it fits");
        let mut cable = Cable::new(camera());
        let info = identify(name, &mut cable);
        cable.refuse = Some(if name == "dvs128" { 0xB3 } else { 0xBF });
        let error = model(name).start(&info, &mut cable).expect_err("refused");
        let text = format!("{error:#}");
        assert!(
            text.contains("re") && text.contains("cable: endpoint"),
            "{text}"
        );

        // Too old.
        let mut cable = Cable::new(camera());
        cable.release &= 0xFF00;
        let error = model(name).identify(&mut cable).expect_err("too old");
        assert!(error.to_string().contains("firmware 0"), "{error}");
    }
}

#[test]
fn a_recording_that_breaks_off_halts_the_endpoint() {
    for (name, width, height) in MODELS {
        let size = sensor(width, height);
        let camera = model(name).camera(size, Box::new(Broken)).expect("it fits");
        let mut cable = Cable::new(camera);
        let info = identify(name, &mut cable);
        model(name).start(&info, &mut cable).expect("it starts");
        let endpoint = model(name).transfers().endpoint;
        for _ in 0..2 {
            let halted = cable.camera.bulk_in(endpoint, 512, &mut Vec::new());
            assert_eq!(halted, Bulk::Stall);
        }
        cable.camera.clear_halt(endpoint);
        let quiet = cable.camera.bulk_in(endpoint, 512, &mut Vec::new());
        assert_eq!(quiet, Bulk::Wait);
    }
}
