//! Switches inputs on again that a flood has switched off.

use embassy_time::Timer;
use firmware::config::MUTE_MS;

use crate::hardware::events::FLOODED;
use crate::hardware::tim2;

#[embassy_executor::task]
pub(crate) async fn run() {
    loop {
        let input = FLOODED.receive().await;
        Timer::after_millis(MUTE_MS).await;
        tim2::unmute(input);
    }
}
