//! Chooses the topic of a bag that is read.

use super::message::Kind;

/// Largest number of event topics kept for messages.
const NAMES_MAX: usize = 64;

/// Largest number of letters of a name in messages.
const NAME_SHOWN: usize = 100;

/// The topic that is read: the one that the caller named, otherwise the first of events, or of images.
#[derive(Debug, Default)]
pub struct Topics {
    /// Whether images are read, and not events.
    images: bool,
    wanted: Option<String>,
    /// The event topics that have occurred, for messages.
    events: Vec<String>,
}

/// How the messages of a topic are treated.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Use {
    /// They are read.
    Read(Kind),
    /// They are skipped and counted under this name.
    Skip(&'static str),
}

impl Topics {
    /// Chooses the topic `place`, with or without its leading slash; `None` chooses the first topic of events.
    #[must_use]
    pub fn new(place: Option<&str>) -> Self {
        let wanted = place.map(|place| format!("/{}", place.trim_matches('/')));
        Self {
            images: false,
            wanted,
            events: Vec::new(),
        }
    }

    /// Chooses the topic `place` of images, or the first one.
    #[must_use]
    pub fn of_images(place: Option<&str>) -> Self {
        Self {
            images: true,
            ..Self::new(place)
        }
    }

    /// Returns how to treat the messages of a topic; to be called for topics as they occur.
    ///
    /// # Errors
    /// The caller asked for this topic, and its messages are not events.
    pub fn meet(&mut self, topic: &str, kind_name: &str) -> Result<Use, String> {
        let named = format!("/{}", topic.trim_start_matches('/'));
        let kind = if self.images {
            Kind::of_image(kind_name)
        } else {
            Kind::of(kind_name)
        };
        let wanted = self.wanted.as_ref().is_some_and(|wanted| *wanted == named);
        let Some(kind) = kind else {
            if wanted {
                let names = if self.images {
                    "images (sensor_msgs/Image)".to_owned()
                } else {
                    format!("events ({})", Kind::NAMES)
                };
                return Err(format!(
                    "the topic {} holds {}, not {names}",
                    shown(topic),
                    shown(kind_name)
                ));
            }
            return Ok(Use::Skip(match kind_name.rsplit('/').next() {
                Some("Imu") => "IMU samples",
                Some("Image" | "CompressedImage") => "frames",
                _ => "other messages",
            }));
        };
        if self.events.len() < NAMES_MAX && !self.events.contains(&named) {
            self.events.push(named.clone());
        }
        if self.wanted.get_or_insert_with(|| named.clone()) == &named {
            Ok(Use::Read(kind))
        } else {
            Ok(Use::Skip("messages of other event topics"))
        }
    }

    /// Describes what is missing if there was no message of the topic.
    #[must_use]
    pub fn missing(&self) -> String {
        match (&self.wanted, self.events.as_slice()) {
            (Some(wanted), []) => format!("no events on the topic {wanted} or any other"),
            (Some(wanted), events) if !events.contains(wanted) => {
                let events: Vec<String> = events.iter().map(|name| shown(name)).collect();
                let events = events.join(", ");
                format!(
                    "no topic {wanted} with events: the recording's topics with events are {events}"
                )
            }
            (Some(wanted), _) => format!("the topic {wanted} holds no messages"),
            (None, _) => format!("no topic holds events ({})", Kind::NAMES),
        }
    }
}

/// Returns a name from a file that may be damaged as a single line.
fn shown(name: &str) -> String {
    let start: String = name.chars().take(NAME_SHOWN).collect();
    start.escape_debug().to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_topic_of_events_or_the_named_one() {
        const PACKET: &str = "event_camera_msgs/msg/EventPacket";
        let mut topics = Topics::new(None);
        let frames = topics.meet("/image", "sensor_msgs/Image");
        assert_eq!(frames, Ok(Use::Skip("frames")));
        assert_eq!(topics.meet("/a", PACKET), Ok(Use::Read(Kind::EventPacket)));
        let other = topics.meet("/b", PACKET);
        assert_eq!(other, Ok(Use::Skip("messages of other event topics")));
        assert_eq!(topics.meet("/a", PACKET), Ok(Use::Read(Kind::EventPacket)));
        let mut topics = Topics::new(Some("b"));
        assert!(matches!(topics.meet("/a", PACKET), Ok(Use::Skip(_))));
        assert!(topics.missing().contains("/a"), "{}", topics.missing());
        assert!(topics.meet("/b", "sensor_msgs/Imu").is_err());
        assert_eq!(topics.meet("b", PACKET), Ok(Use::Read(Kind::EventPacket)));
    }
}
