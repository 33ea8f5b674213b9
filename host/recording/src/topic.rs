//! The topics of a recording: one table, from which writer, reader, checks, extraction
//! and live data take name, type and schema.
//!
//! A new topic is a row at the end of the table (the rows number the channels of every
//! recording, so none is moved or removed) and what it means wherever the compiler then
//! asks for it.

use super::messages::{
    BoardRun, Capture, CdrError, ClockExchange, ClockModel, DiagnosticArray, Imu, LinkFrame, Log,
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
    /// Trigger pulses, and the same instants in the phone's time.
    Trigger: TimeReference = "/board/trigger",
    /// The same pulses in full.
    Pulse: Pulse = "/board/trigger_pulse",
    /// Edges on the strobe input, and the same instants in the phone's time.
    Strobe: TimeReference = "/board/strobe",
    /// The same edges in full.
    Capture: Capture = "/board/strobe_capture",
    /// State and counters of the board, once a second.
    Status: DiagnosticArray = "/board/status",
    /// Every frame of the link as it came.
    Link: LinkFrame = "/link/frames",
    /// The relation of the clocks of board and phone, whenever a better one is known.
    Clock: ClockModel = "/session/clock_model",
    /// Markers; `source` is the label.
    Marker: TimeReference = "/session/markers",
    /// Wall clock of the host, once a second.
    HostTime: TimeReference = "/session/host_time",
    /// What was said and what went wrong.
    Log: Log = "/session/log",
    /// Pulses of the further outputs; `frame_id` says whose.
    Output: Pulse = "/board/output_pulse",
    /// Pulses per second; `time_ref` is the UTC that a lidar was told.
    Gnss: TimeReference = "/board/gnss",
    /// The board was reset: how its time goes on.
    Run: BoardRun = "/session/board_run",
    /// The relation of the clocks of a further phone; `frame_id` says whose.
    PhoneClock: ClockModel = "/session/phone_clock_model",
    /// Board and phone were asked for their time, while the phone's clock is followed.
    Exchange: ClockExchange = "/session/clock_exchanges",
    /// The trigger's period follows the phone's clock.
    Period: TriggerPeriod = "/session/trigger_period",
}

impl Topic {
    /// The topic of that name; `None` if this version does not know it.
    #[must_use]
    pub fn of(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|topic| topic.name() == name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rosbag2::{QOS, QOS_KEY};

    /// What readers of older recordings rely on, and what a repair assumes where the
    /// description of the topics is lost.
    #[test]
    fn channels_are_those_of_every_recording_before() {
        let mut known = Vec::new();
        let mut bag = crate::writer::bag_of_topics(std::io::sink()).unwrap();
        for (id, channel) in bag.mcap.finish().unwrap().channels {
            let schema = channel.schema.as_ref().unwrap();
            assert_eq!(schema.encoding, "ros2msg");
            assert_eq!(channel.message_encoding, "cdr");
            assert_eq!(channel.metadata.len(), 1);
            assert_eq!(channel.metadata[QOS_KEY], QOS);
            known.push((
                id,
                channel.topic.clone(),
                schema.id,
                schema.name.clone(),
                crc32fast::hash(&schema.data),
            ));
        }
        known.sort();
        let expected = [
            (1, "/board/imu", 1, "sensor_msgs/msg/Imu", 0x59eb_ebc6),
            (
                2,
                "/board/imu_temperature",
                2,
                "sensor_msgs/msg/Temperature",
                0x37f7_854f,
            ),
            (
                3,
                "/board/trigger",
                3,
                "sensor_msgs/msg/TimeReference",
                0x88b3_26f7,
            ),
            (
                4,
                "/board/trigger_pulse",
                4,
                "smartdepthsync_msgs/msg/Pulse",
                0xb312_b98f,
            ),
            (
                5,
                "/board/strobe",
                3,
                "sensor_msgs/msg/TimeReference",
                0x88b3_26f7,
            ),
            (
                6,
                "/board/strobe_capture",
                5,
                "smartdepthsync_msgs/msg/Capture",
                0xb98d_ef47,
            ),
            (
                7,
                "/board/status",
                6,
                "diagnostic_msgs/msg/DiagnosticArray",
                0x9907_59bd,
            ),
            (
                8,
                "/link/frames",
                7,
                "smartdepthsync_msgs/msg/LinkFrame",
                0x4497_035f,
            ),
            (
                9,
                "/session/clock_model",
                8,
                "smartdepthsync_msgs/msg/ClockModel",
                0x422d_4257,
            ),
            (
                10,
                "/session/markers",
                3,
                "sensor_msgs/msg/TimeReference",
                0x88b3_26f7,
            ),
            (
                11,
                "/session/host_time",
                3,
                "sensor_msgs/msg/TimeReference",
                0x88b3_26f7,
            ),
            (12, "/session/log", 9, "rcl_interfaces/msg/Log", 0x8f31_a2e6),
            (
                13,
                "/board/output_pulse",
                4,
                "smartdepthsync_msgs/msg/Pulse",
                0xb312_b98f,
            ),
            (
                14,
                "/board/gnss",
                3,
                "sensor_msgs/msg/TimeReference",
                0x88b3_26f7,
            ),
            (
                15,
                "/session/board_run",
                10,
                "smartdepthsync_msgs/msg/BoardRun",
                0x7517_6a77,
            ),
            (
                16,
                "/session/phone_clock_model",
                8,
                "smartdepthsync_msgs/msg/ClockModel",
                0x422d_4257,
            ),
            (
                17,
                "/session/clock_exchanges",
                11,
                "smartdepthsync_msgs/msg/ClockExchange",
                0x7361_60b4,
            ),
            (
                18,
                "/session/trigger_period",
                12,
                "smartdepthsync_msgs/msg/TriggerPeriod",
                0x59c3_f380,
            ),
        ];
        let expected = expected.map(|(id, topic, schema, name, hash)| {
            (id, topic.to_owned(), schema, name.to_owned(), hash)
        });
        assert_eq!(known, expected);
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
