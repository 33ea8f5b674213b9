//! One thing that both cameras see: a ball that swings before a wall.
//!
//! Each picture is the ball where it is at the time of the pixel's exposure: of the phone
//! row by row (rolling shutter), of the depth camera at the centre of exposure. So two
//! pictures of one time show it at one place, and a picture that is late shows it elsewhere:
//! at its fastest it moves by 1.6 widths of the picture a second, 0.16 % in a millisecond.
//!
//! Limits: both cameras stand at one place and have one field of view; during an exposure
//! (0.5 ms of a row, 12.7 ms of the depth camera) it stands still.

use crate::clocks::oscillator::TrueTime;
use crate::depth_camera::FrameRecord;
use stm32f4_sim::time::UNITS_PER_SECOND;

/// Size of the pictures that show it: of the phone, and of the depth camera.
pub const PHONE_SIZE: (usize, usize) = (320, 180);
/// Columns and rows of the depth picture.
pub const DEPTH_SIZE: (u32, u32) = (160, 90);

/// Distance of the ball and of the wall, mm.
const DEPTHS_MM: (u16, u16) = (900, 2_400);

/// Radius in parts of the picture's height.
const RADIUS: f64 = 0.16;

/// Height over width of a picture.
const ASPECT: f64 = 9.0 / 16.0;

/// Its middle, in parts of the picture's width and height.
fn middle(at: TrueTime) -> (f64, f64) {
    let seconds = at.units() as f64 / UNITS_PER_SECOND as f64;
    let turn = std::f64::consts::TAU * (seconds / 1.2).fract();
    (0.5 + 0.3 * turn.sin(), 0.55 - 0.2 * turn.cos().powi(2))
}

/// The columns of a row, in parts of the width, that the ball covers at a time; `row` is in
/// parts of the height.
pub(crate) fn columns(row: f64, at: TrueTime) -> Option<(f64, f64)> {
    let (x, y) = middle(at);
    let half = (RADIUS * RADIUS - (row - y) * (row - y)).max(0.0).sqrt() * ASPECT;
    (half > 0.0).then_some((x - half, x + half))
}

/// Paints what lies before the wall at a time with `paint`, row by row.
fn paint(
    width: usize,
    height: usize,
    mut at: impl FnMut(usize) -> TrueTime,
    mut paint: impl FnMut(usize),
) {
    for row in 0..height {
        let place = (row as f64 + 0.5) / height as f64;
        let Some((from, to)) = columns(place, at(row)) else {
            continue;
        };
        let column = |part: f64| ((part * width as f64).round().max(0.0) as usize).min(width);
        for column in column(from)..column(to) {
            paint(row * width + column);
        }
    }
}

/// Makes the ball brighter than the wall in a picture of the phone; `at` is the middle of
/// exposure of a row.
pub(crate) fn into_phone(
    pixels: &mut [u8],
    width: usize,
    height: usize,
    at: impl FnMut(usize) -> TrueTime,
) {
    paint(width, height, at, |index| {
        if let Some(pixel) = pixels.get_mut(index) {
            *pixel = pixel.saturating_add(110);
        }
    });
}

/// The depth picture of [`DEPTH_SIZE`] of a frame, mm.
pub fn depth_picture(frame: &FrameRecord, pixels: &mut [u16]) {
    depth_at(pixels, frame.center_true);
}

fn depth_at(pixels: &mut [u16], at: TrueTime) {
    let (ball, wall) = DEPTHS_MM;
    pixels.fill(wall);
    let (width, height) = (DEPTH_SIZE.0 as usize, DEPTH_SIZE.1 as usize);
    paint(
        width,
        height,
        |_| at,
        |index| {
            if let Some(pixel) = pixels.get_mut(index) {
                *pixel = ball;
            }
        },
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_cameras_see_it_at_one_place() {
        for tenths in 0..24 {
            let at = TrueTime::from_units(UNITS_PER_SECOND / 10 * tenths);
            let mut depth = vec![0; (DEPTH_SIZE.0 * DEPTH_SIZE.1) as usize];
            depth_at(&mut depth, at);
            let (width, height) = PHONE_SIZE;
            let mut phone = vec![30_u8; width * height];
            into_phone(&mut phone, width, height, |_| at);
            // The middle of what was painted, in parts of the width.
            let middle = |painted: Vec<usize>, width: usize| {
                let sum: usize = painted.iter().map(|index| index % width).sum();
                (sum as f64 / painted.len() as f64 + 0.5) / width as f64
            };
            let near = |of: &[u16]| (0..of.len()).filter(|&i| of[i] == DEPTHS_MM.0).collect();
            let bright = (0..phone.len()).filter(|&i| phone[i] > 100).collect();
            let apart = middle(near(&depth), DEPTH_SIZE.0 as usize) - middle(bright, width);
            assert!(apart.abs() < 0.005, "{tenths}: {apart}");
        }
    }
}
