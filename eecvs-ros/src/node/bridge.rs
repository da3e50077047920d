//! `bridge`: publishes a USB camera, or an encoder on USB or a serial port.

use anyhow::Result;
use clap::Args;
use eecvs_cli::codec::CodecOptions;
use event_files::{EventReader, Pause};
use usb_bridge::cmd::options::{DeviceOptions, StreamOptions, warn_of_losses};
use usb_bridge::device::mcu;
use usb_bridge::record::{Order, encoders_frames};
use usb_bridge::session::Session;

use super::emulate::PacketOptions;
use super::frames::FrameSender;
use super::{Context, LossOptions, QosOptions, refuse_losses};
use crate::message::{EventPacket, Time};
use crate::operator::{Eecvs, Encoded, Operator, frames};

/// Topics that the node publishes.
pub const PUBLISHES: &[&str] = &["events", "frames"];

/// Publish what a device sends: a camera's events on `events`, an encoder's frames on `frames`
#[derive(Debug, Clone, Args)]
pub struct Bridge {
    #[command(flatten)]
    device: DeviceOptions,

    #[command(flatten)]
    stream: StreamOptions,

    #[command(flatten)]
    codec: CodecOptions,

    #[command(flatten)]
    packets: PacketOptions,

    #[command(flatten)]
    losses: LossOptions,

    #[command(flatten)]
    qos: QosOptions,
}

impl Bridge {
    /// Publishes until a stop is requested or the device ends.
    ///
    /// # Errors
    /// The device cannot be reached, its link fails, the transport fails, or something was lost and the options do not
    /// allow it.
    pub fn run(self, mut context: Context) -> Result<()> {
        let source = self.device.open(&self.codec, &context.stop)?;
        let sends_frames = source.model.name() == mcu::NAME;
        let session = Session::start(
            source,
            self.stream.queue_bytes(),
            &context.stop,
            self.stream.limits(),
        )?;
        let published = match sends_frames {
            true => self.frames(&mut context, &session),
            false => self.events(&mut context, &session),
        };
        let (report, unstopped) = session.finish();
        warn_of_losses(&report);
        let (published, late) = published?;
        context.say(&published);
        unstopped.map_or(Ok(()), Err)?;
        let mut losses: Vec<(u64, &str)> = report
            .losses
            .iter()
            .map(|(cause, count)| (*count, *cause))
            .collect();
        losses.push((late, "events came too late and are in no frame"));
        refuse_losses(self.losses.allow_loss, &losses)
    }

    /// Publishes the encoder's frames unchanged. They are stamped on arrival, since the encoder's times do not show
    /// when, by the computer's clock, the windows ended. Returns what was published, and the number of late events.
    fn frames(&self, context: &mut Context, session: &Session) -> Result<(String, u64)> {
        let name = Eecvs.name();
        let mut sender = FrameSender::new(context, self.qos.qos(), name, self.packets.frame_id())?;
        let mut put = |encoded: Encoded<'_>| sender.send(encoded, Time::now());
        let mut out = frames(&mut put);
        let mut order = Order::default();
        let ended = encoders_frames(session, &mut out, &mut order);
        out.finish(ended)?;
        let line = format!(
            "{} frames in {} runs of the clock; {} events late at the encoder",
            sender.sent(),
            order.runs,
            order.events_late
        );
        Ok((line, order.events_late))
    }

    fn events(&self, context: &mut Context, session: &Session) -> Result<(String, u64)> {
        let mut sender = context.publisher::<EventPacket>("events", self.qos.qos())?;
        let mut reader = session.reader();
        let mut packer = self.packets.packer(reader.sensor());
        let (mut events, mut published) = (Vec::new(), 0_u64);
        loop {
            events.clear();
            if reader.read(&mut events)? == 0 && reader.pause() == Pause::Ended {
                break;
            }
            packer.push(&events, |packet, _| sender.send(packet))?;
            // Publish at once, even if the message is not full.
            packer.flush(&mut |packet: &EventPacket, _| sender.send(packet))?;
            published += events.len() as u64;
        }
        let line = format!("{published} events in {} messages", sender.sent().messages);
        Ok((line, 0))
    }
}
