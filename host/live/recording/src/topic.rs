//! The topics of a recording: one table, from which writer, reader, checks, extraction
//! and live data take name, type and schema.
//!
//! A new topic is a row of the table and what it means wherever the compiler then asks for it.
//! Each fact is on one topic. The running number of a message is the board's own where the
//! board numbers them, so that a gap shows what was lost anywhere on the way.

use board::Stream;

use super::messages::{
    Capture, CdrError, ClockExchange, ClockModel, DiagnosticArray, Imu, ImuFlags, LinkFrame, Log,
    Pulse, RosMessage as _, Temperature, TimeReference, TriggerPeriod, from_cdr, to_cdr,
};

macro_rules! topics {
    ($($(#[$doc:meta])* $topic:ident: $message:ident = $name:literal,)+) => {
        /// A topic.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        pub enum Topic {
            $($(#[$doc])* $topic,)+
        }

        /// A message on its topic.
        #[derive(Clone, Debug, PartialEq)]
        #[allow(
            clippy::large_enum_variant,
            reason = "messages are written and read one at a time"
        )]
        pub enum Item {
            $($(#[$doc])* $topic($message),)+
        }

        impl Topic {
            /// All of them in the order of their channels; `topic as usize` is the place
            /// of each.
            pub const ALL: [Self; [$($name),+].len()] = [$(Self::$topic),+];

            /// Its name in the file.
            #[must_use]
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$topic => $name,)+
                }
            }

            /// Full name of the ROS 2 type of its messages.
            #[must_use]
            pub const fn message_type(self) -> &'static str {
                match self {
                    $(Self::$topic => $message::TYPE,)+
                }
            }

            /// The type's definition as an MCAP schema of encoding `ros2msg`.
            #[must_use]
            pub fn schema(self) -> String {
                match self {
                    $(Self::$topic => $message::schema(),)+
                }
            }

            /// Reads a message from its CDR form.
            ///
            /// # Errors
            ///
            /// The bytes are no CDR, or not of this topic's type.
            pub fn read(self, data: &[u8]) -> Result<Item, CdrError> {
                match self {
                    $(Self::$topic => from_cdr(data).map(Item::$topic),)+
                }
            }
        }

        impl Item {
            /// The topic that it is on.
            #[must_use]
            pub const fn topic(&self) -> Topic {
                match self {
                    $(Self::$topic(_) => Topic::$topic,)+
                }
            }

            /// Its CDR form.
            pub(crate) fn to_cdr(&self) -> Result<Vec<u8>, CdrError> {
                match self {
                    $(Self::$topic(message) => to_cdr(message),)+
                }
            }
        }
    };
}

topics! {
    /// Samples of the board's IMU.
    Imu: Imu = "/board/imu",
    /// The IMU's temperature at each sample.
    Temperature: Temperature = "/board/imu_temperature",
    /// Samples about which something was unusual.
    ImuFlags: ImuFlags = "/board/imu_flags",
    /// Trigger pulses.
    Pulse: Pulse = "/board/trigger",
    /// Edges on the strobe input.
    Capture: Capture = "/board/strobe",
    /// State and counters of the board, once a second.
    Status: DiagnosticArray = "/board/status",
    /// The relation of the clocks of board and phone, whenever a better one is known.
    Clock: ClockModel = "/session/clock_model",
    /// Markers; `source` is the label.
    Marker: TimeReference = "/session/markers",
    /// Wall clock of the host, once a second.
    HostTime: TimeReference = "/session/host_time",
    /// What was said and what went wrong.
    Log: Log = "/session/log",
    /// Pulses of the auxiliary outputs; `frame_id` says whose.
    Output: Pulse = "/board/output_pulse",
    /// Pulses per second; `time_ref` is the UTC that a lidar was told.
    Gnss: TimeReference = "/board/gnss",
    /// The relation of the clocks of another phone; `frame_id` says whose.
    PhoneClock: ClockModel = "/session/phone_clock_model",
    /// Board and phone were asked for their time, while the phone's clock is followed.
    Exchange: ClockExchange = "/session/clock_exchanges",
    /// The trigger's period follows the phone's clock.
    Period: TriggerPeriod = "/session/trigger_period",
    /// Every frame of the link as it came, if that is asked for.
    Link: LinkFrame = "/link/frames",
}

impl Topic {
    /// The topic of that name; `None` if this version does not know it.
    #[must_use]
    pub fn of(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|topic| topic.name() == name)
    }

    /// Returns the stream of the board whose numbers its messages carry.
    #[must_use]
    pub const fn stream(self) -> Option<Stream> {
        Some(match self {
            Self::Status => Stream::Status,
            Self::Pulse => Stream::Pulses,
            Self::Capture => Stream::Captures,
            Self::Imu => Stream::Imu,
            Self::Output => Stream::Outputs,
            Self::Gnss => Stream::Pps,
            _ => return None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rosbag2::{QOS, QOS_KEY};

    /// What readers of other programs rely on, and what a reader assumes where the
    /// description of the topics is lost.
    #[test]
    fn channels_are_the_rows_of_the_table() {
        let mut bag = crate::writer::bag_of_topics(std::io::sink()).unwrap();
        let channels = bag.mcap.finish().unwrap().channels;
        assert_eq!(channels.len(), Topic::ALL.len());
        for (topic, id) in Topic::ALL.into_iter().zip(1..) {
            let channel = &channels[&id];
            let schema = channel.schema.as_ref().unwrap();
            assert_eq!(channel.topic, topic.name());
            assert_eq!(schema.name, topic.message_type());
            assert_eq!(schema.data, topic.schema().as_bytes());
            assert_eq!(schema.encoding, "ros2msg");
            assert_eq!(channel.message_encoding, "cdr");
            assert_eq!(channel.metadata.len(), 1);
            assert_eq!(channel.metadata[QOS_KEY], QOS);
        }
    }

    #[test]
    fn topics_are_known_by_their_names() {
        for (place, topic) in Topic::ALL.into_iter().enumerate() {
            assert_eq!(topic as usize, place);
            assert_eq!(Topic::of(topic.name()), Some(topic));
        }
        assert_eq!(Topic::of("/board/other"), None);
    }
}
