//! The devices of a session on hardware: a serial port, and `adb` for the
//! phone's clock. The phone's app is [`PhoneTask`](phone::task::PhoneTask), and the depth
//! recorder a [process](crate::devices::recorder_process).

use board::BoardError;
use board::transport::serial::{SerialLink, program_time};
use board::transport::{Link, ports};
use phone::PhoneError;
use phone::agent::{Agent, PhoneExchange};
use system::Cancel;

use crate::devices::{Connector, PhoneClock, PhoneClockStarter};

/// Connects to the board on a serial port, and finds it again if it returns under another name.
#[derive(Clone, Debug)]
pub struct SerialConnector {
    /// Path of the port, if the user gave one.
    pub port: Option<String>,
}

impl Connector for SerialConnector {
    fn connect(&mut self, board_id: Option<&str>) -> board::Result<Box<dyn Link>> {
        // A board that was unplugged may return under another name.
        let renamed = board_id.and_then(|id| {
            ports::list().ok()?.into_iter().find_map(|port| {
                let serial = port.usb.as_ref()?.serial_number.as_deref()?;
                (port.board && serial == id).then_some(port.path)
            })
        });
        let path = match renamed {
            Some(path) => path,
            None => board::choose_port(self.port.as_deref())?,
        };
        Ok(Box::new(SerialLink::open(&path).map_err(BoardError::from)?))
    }
}

/// Starts a program on the phone that reads its clock, through `adb`.
pub struct AdbClockStarter {
    /// Cancels the start and the answers of the program.
    pub cancel: Cancel,
}

impl PhoneClockStarter for AdbClockStarter {
    fn is_possible(&self) -> bool {
        phone::adb::server_runs()
    }

    fn start(&mut self) -> Result<Box<dyn PhoneClock>, PhoneError> {
        let agent = Agent::start(program_time, &self.cancel)?;
        Ok(Box::new(AdbClock(agent)))
    }
}

struct AdbClock(Agent);

impl PhoneClock for AdbClock {
    fn device(&self) -> &str {
        self.0.device()
    }

    fn is_by_network(&self) -> bool {
        self.0.is_by_network()
    }

    fn exchanges(&mut self) -> Vec<PhoneExchange> {
        self.0.exchanges().collect()
    }
}
