//! Live data for Foxglove, over its websocket: `--foxglove`.
//!
//! Nothing listens unless it is asked for, and then on this computer only unless
//! another address is given. Whoever connects may look, and nothing else: the
//! server offers no service, no parameter and takes no message.
//!
//! The topics are those of a recording, in the same form (see `docs/formats.md`)
//! and with the same times, so that one layout shows both; the raw frames of the
//! link are left out. [`STATE_TOPIC`] adds the state that the live view shows.
//!
//! The official SDK (`foxglove`) serves on threads of its own. A message goes into
//! a queue of bounded length for each client; a client that does not read loses the
//! oldest of its queue, and nobody waits for it. It is a feature of the build
//! (`foxglove`, in the default set) for the crates that the SDK brings.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};

#[cfg(feature = "foxglove")]
pub use serve::LiveData;

#[cfg(not(feature = "foxglove"))]
pub use absent::LiveData;

use crate::context::Context;
use crate::outcome::Failure;

/// The port that Foxglove tries first.
const PORT: u16 = 8765;

/// The topic of the live view's state, as JSON: that of `monitor --json`.
pub const STATE_TOPIC: &str = "/session/state";

/// The option of commands that can serve live data.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct FoxgloveArg {
    /// Serve live data for Foxglove on a websocket; on this computer only, unless
    /// another address is given
    #[arg(
        long,
        value_name = "ADDRESS",
        num_args = 0..=1,
        default_missing_value = "127.0.0.1:8765",
        value_parser = parse_address
    )]
    foxglove: Option<SocketAddr>,
}

impl FoxgloveArg {
    /// Serves, if it was asked for, and says where.
    ///
    /// # Errors
    ///
    /// The address cannot be listened on; or this build cannot serve.
    pub(crate) fn open(&self, context: &Context) -> Result<Option<LiveData>, Failure> {
        let Some(asked) = self.foxglove else {
            return Ok(None);
        };
        let live = LiveData::open(asked)?;
        let address = SocketAddr::new(asked.ip(), live.port());
        context.say(format!("live data for Foxglove: ws://{address}"));
        if !asked.ip().is_loopback() {
            context.say(
                "warning: whoever reaches that address can look on; it has no password and is \
                 not encrypted",
            );
        }
        Ok(Some(live))
    }
}

/// `ADDRESS` or `ADDRESS:PORT`.
fn parse_address(text: &str) -> Result<SocketAddr, String> {
    let bare = |text: &str| text.parse().map(|ip: IpAddr| SocketAddr::new(ip, PORT));
    if text == "localhost" {
        return Ok(SocketAddr::new(Ipv4Addr::LOCALHOST.into(), PORT));
    }
    text.parse().or_else(|_| bare(text)).map_err(|_| {
        String::from(
            "expected an address of this computer such as 127.0.0.1:8765 (for itself only) or \
             0.0.0.0:8765 (for the whole network)",
        )
    })
}

#[cfg(feature = "foxglove")]
mod serve {
    use std::io::ErrorKind;
    use std::net::SocketAddr;
    use std::sync::Arc;

    use foxglove::{
        ChannelBuilder, Context, FoxgloveError, PartialMetadata, RawChannel, Schema,
        WebSocketServer, WebSocketServerHandle,
    };
    use protocol::Ticks;

    use super::STATE_TOPIC;
    use crate::outcome::{ExitStatus, Failure};
    use crate::view::Snapshot;
    use recording::writer::Output;
    use recording::{RecordingError, Topic};

    /// A server of live data. The last copy to be dropped ends it.
    #[derive(Clone)]
    pub struct LiveData(Arc<Served>);

    struct Served {
        /// In the order of [`Topic::ALL`]; none for what is not shown.
        channels: Vec<Option<Arc<RawChannel>>>,
        state: Arc<RawChannel>,
        server: Option<WebSocketServerHandle>,
        port: u16,
        /// Channels live as long as it does.
        _context: Arc<Context>,
    }

    impl LiveData {
        /// Listens on an address; port 0 takes any that is free.
        ///
        /// # Errors
        ///
        /// It cannot be listened on.
        pub fn open(address: SocketAddr) -> Result<Self, Failure> {
            let failed = |error: FoxgloveError| {
                let step = match &error {
                    FoxgloveError::Bind(source) if source.kind() == ErrorKind::AddrInUse => {
                        "another program serves there: end it, or take another port, such as \
                         `--foxglove 127.0.0.1:8766`"
                    }
                    _ => {
                        "give an address of this computer, such as `--foxglove 127.0.0.1:8765`, \
                         or leave the option out"
                    }
                };
                Failure::new(
                    ExitStatus::Error,
                    format!("cannot serve live data on {address}: {error}"),
                )
                .next_step(step)
            };
            let context = Context::new();
            let channel = |name: &str, encoding: &str, schema: Schema| {
                ChannelBuilder::new(name)
                    .message_encoding(encoding)
                    .schema(schema)
                    .context(&context)
                    .build_raw()
                    .map_err(failed)
            };
            let mut channels = Vec::new();
            for topic in Topic::ALL {
                let schema =
                    Schema::new(topic.message_type(), "ros2msg", topic.schema().into_bytes());
                channels.push(match topic {
                    Topic::Link => None,
                    _ => Some(channel(topic.name(), "cdr", schema)?),
                });
            }
            let any = br#"{"type": "object"}"#.as_slice();
            let schema = Schema::new("smartdepthsync.State", "jsonschema", any);
            let state = channel(STATE_TOPIC, "json", schema)?;
            let host = match address {
                SocketAddr::V4(v4) => v4.ip().to_string(),
                SocketAddr::V6(v6) => format!("[{}]", v6.ip()),
            };
            let server = WebSocketServer::new()
                .name("smartdepthsync")
                .bind(host, address.port())
                .context(&context)
                .start_blocking()
                .map_err(failed)?;
            Ok(Self(Arc::new(Served {
                channels,
                state,
                port: server.port(),
                server: Some(server),
                _context: context,
            })))
        }

        /// The port it listens on.
        #[must_use]
        pub fn port(&self) -> u16 {
            self.0.port
        }

        /// The state that the live view shows.
        pub(crate) fn state(&self, snapshot: &Snapshot) {
            if !self.0.state.has_sinks() {
                return;
            }
            // A snapshot is numbers and texts: it always has a JSON form.
            if let Ok(text) = serde_json::to_vec(snapshot) {
                log(&self.0.state, snapshot.now, &text);
            }
        }
    }

    impl Output for LiveData {
        fn put(&mut self, topic: Topic, at: Ticks, data: &[u8]) -> Result<(), RecordingError> {
            if let Some(Some(channel)) = self.0.channels.get(topic as usize) {
                log(channel, at, data);
            }
            Ok(())
        }
    }

    fn log(channel: &RawChannel, at: Ticks, data: &[u8]) {
        let metadata = PartialMetadata {
            log_time: Some(at.as_nanos()),
        };
        channel.log_with_meta(data, metadata);
    }

    impl Drop for Served {
        fn drop(&mut self) {
            if let Some(server) = self.server.take() {
                // Clients are sent away; nobody waits for them.
                drop(server.stop());
            }
        }
    }
}

#[cfg(not(feature = "foxglove"))]
mod absent {
    use std::net::SocketAddr;

    use protocol::Ticks;

    use crate::outcome::{ExitStatus, Failure};
    use crate::view::Snapshot;
    use recording::writer::Output;
    use recording::{RecordingError, Topic};

    /// There never is one: this build was made without the feature.
    #[derive(Clone)]
    pub struct LiveData(());

    impl LiveData {
        /// Says that this build cannot.
        ///
        /// # Errors
        ///
        /// Always.
        pub fn open(_address: SocketAddr) -> Result<Self, Failure> {
            Err(Failure::new(
                ExitStatus::Usage,
                "this build was made without live data for Foxglove",
            )
            .next_step(
                "install it with its default features: `cargo install --locked --path host/cli`",
            ))
        }

        /// 0.
        #[must_use]
        pub const fn port(&self) -> u16 {
            0
        }

        /// Shows it to nobody.
        pub(crate) const fn state(&self, _snapshot: &Snapshot) {}
    }

    impl Output for LiveData {
        fn put(&mut self, _topic: Topic, _at: Ticks, _data: &[u8]) -> Result<(), RecordingError> {
            Ok(())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_without_a_port_gets_the_usual_one() {
        let parse = |text: &str| parse_address(text).unwrap().to_string();
        assert_eq!(parse("127.0.0.1"), "127.0.0.1:8765");
        assert_eq!(parse("localhost"), "127.0.0.1:8765");
        assert_eq!(parse("0.0.0.0:80"), "0.0.0.0:80");
        assert_eq!(parse("::1"), "[::1]:8765");
        assert_eq!(parse("[::1]:9000"), "[::1]:9000");
        for text in [
            "",
            "8765",
            "nowhere",
            "127.0.0.1:",
            "127.0.0.1:99999",
            "1.2.3",
        ] {
            assert!(parse_address(text).is_err(), "{text}");
        }
    }
}
