//! The topics of a recording: one table with name, type and schema, which writer, reader,
//! verification, extraction and live data share.
//!
//! A new topic is a row of the table; the compiler then names the places that must handle it.
//! Each fact is on one topic. The running number of a message is the board's own where the
//! board numbers them, so that a gap shows a loss anywhere on the way.

use board::Stream;

use super::messages::{
    Capture, CdrError, ClockExchange, ClockModel, DiagnosticArray, Imu, ImuFlags, LinkFrame, Log,
    Pulse, RosMessage as _, Temperature, Time, TimeReference, TriggerPeriod, from_cdr, to_cdr,
};

macro_rules! topics {
    ($($(#[$doc:meta])* $topic:ident: $message:ident = $name:literal,)+) => {
        /// A topic of a recording.
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
            /// All topics in the order of their channels; `topic as usize` is the index.
            pub const ALL: [Self; [$($name),+].len()] = [$(Self::$topic),+];

            /// Returns the name in the file.
            #[must_use]
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$topic => $name,)+
                }
            }

            /// Returns the full name of the ROS 2 type of its messages.
            #[must_use]
            pub const fn message_type(self) -> &'static str {
                match self {
                    $(Self::$topic => $message::TYPE,)+
                }
            }

            /// Returns the type's definition as an MCAP schema of encoding `ros2msg`.
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
            /// Returns an error if the bytes are not CDR, or not of this topic's type.
            pub fn read(self, data: &[u8]) -> Result<Item, CdrError> {
                match self {
                    $(Self::$topic => from_cdr(data).map(Item::$topic),)+
                }
            }
        }

        impl Item {
            /// Returns the topic of the message.
            #[must_use]
            pub const fn topic(&self) -> Topic {
                match self {
                    $(Self::$topic(_) => Topic::$topic,)+
                }
            }

            /// Writes the message in its CDR form.
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
    /// Temperature of the IMU at each sample.
    Temperature: Temperature = "/board/imu_temperature",
    /// Flags of unusual samples.
    ImuFlags: ImuFlags = "/board/imu_flags",
    /// Trigger pulses.
    Pulse: Pulse = "/board/trigger",
    /// Edges on the strobe input.
    Capture: Capture = "/board/strobe",
    /// State and counters of the board, once a second.
    Status: DiagnosticArray = "/board/status",
    /// Relation of the clocks of board and phone, whenever a better one is known.
    Clock: ClockModel = "/session/clock_model",
    /// Markers; `source` is the label.
    Marker: TimeReference = "/session/markers",
    /// Wall clock of the host, once a second.
    HostTime: TimeReference = "/session/host_time",
    /// Events of the session and problems.
    Log: Log = "/session/log",
    /// Pulses of the auxiliary outputs; `frame_id` is the name of the sensor.
    Output: Pulse = "/board/output_pulse",
    /// Pulses per second; `time_ref` is the UTC that was sent to a lidar.
    Gnss: TimeReference = "/board/gnss",
    /// Relation of the clock of another phone; `frame_id` is its name.
    PhoneClock: ClockModel = "/session/phone_clock_model",
    /// Questions to board and phone for their time, while the phone's clock is followed.
    Exchange: ClockExchange = "/session/clock_exchanges",
    /// Changes of the trigger's period, which follows the phone's clock.
    Period: TriggerPeriod = "/session/trigger_period",
    /// Every frame of the link as it came, on request.
    Link: LinkFrame = "/link/frames",
}

impl Item {
    /// Returns the board time that the message states itself, if that is when it was recorded: a
    /// relation of clocks states its reference.
    pub(crate) const fn stamp(&self) -> Option<Time> {
        Some(match self {
            Self::Imu(message) => message.header.stamp,
            Self::Temperature(message) => message.header.stamp,
            Self::ImuFlags(message) => message.header.stamp,
            Self::Pulse(message) | Self::Output(message) => message.header.stamp,
            Self::Capture(message) => message.header.stamp,
            Self::Status(message) => message.header.stamp,
            Self::Marker(message) | Self::HostTime(message) | Self::Gnss(message) => {
                message.header.stamp
            }
            Self::Log(message) => message.stamp,
            Self::Exchange(message) => message.header.stamp,
            Self::Period(message) => message.header.stamp,
            Self::Link(message) => message.header.stamp,
            Self::Clock(_) | Self::PhoneClock(_) => return None,
        })
    }
}

impl Topic {
    /// Returns the topic with that name; `None` if this version does not know it.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|topic| topic.name() == name)
    }

    /// Returns the stream of the board whose numbers the messages carry, if there is one.
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

    /// Readers of other programs rely on this, and our reader does where the description of the
    /// topics is lost.
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
        for (index, topic) in Topic::ALL.into_iter().enumerate() {
            assert_eq!(topic as usize, index);
            assert_eq!(Topic::from_name(topic.name()), Some(topic));
        }
        assert_eq!(Topic::from_name("/board/other"), None);
    }
}
