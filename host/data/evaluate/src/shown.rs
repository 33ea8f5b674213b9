//! The data of a recording that a report draws.

use crate::Settings;
use crate::footage::frame::RowReducer;
use crate::footage::{Footage, Picture};
use crate::track::Track;

/// Profiles of the sensor's rows, and one frame. Rows are counted from 0 in read-out order,
/// flashes from 1.
#[derive(Debug, Clone)]
pub struct Shown {
    /// First row of the profiles.
    pub first_row: f64,
    /// Middle row of the sensor.
    pub middle_row: f64,
    /// Mean brightness of each row over some of the used frames, grey levels.
    pub mean_profile: Vec<f64>,
    /// Fitted profile of the same frames, grey levels.
    pub fitted_profile: Vec<f64>,
    /// Flashes in the profiles: number and row.
    pub flashes: Vec<(u32, f64)>,
    /// One frame.
    pub picture: Picture,
    /// Flashes in that frame: number and row; empty if it was not used.
    pub picture_flashes: Vec<(u32, f64)>,
    reducer: RowReducer,
}

impl Shown {
    pub(crate) fn new(footage: &Footage, track: &Track, settings: &Settings) -> Self {
        let first_row = footage.reducer.first_row() as f64;
        let middle_row = footage.middle_row;
        let train = settings.train;
        let shown = first_row..first_row + footage.rows.len as f64;
        let flashes = |bias_us: f64| {
            let bias_us = bias_us + settings.path_delay_us;
            (0..train.count)
                .map(|k| {
                    let after_us = train.flash_us(k, bias_us);
                    (k + 1, middle_row + after_us / track.joint.row_time_us)
                })
                .filter(|(_, row)| shown.contains(row))
                .collect()
        };
        // The flashes of another frame lie elsewhere.
        let picture = &footage.picture;
        let own = track.points.iter().find(|p| p.index == picture.index);
        Self {
            first_row,
            middle_row,
            mean_profile: track.mean_profile.clone(),
            fitted_profile: track.fitted_profile.clone(),
            flashes: flashes(track.shown_bias_us),
            picture: picture.clone(),
            picture_flashes: own.map_or_else(Vec::new, |p| flashes(p.bias_us)),
            reducer: footage.reducer.clone(),
        }
    }

    /// Returns the line of the picture at the centre of a sensor row, and true if rows are
    /// columns of the picture.
    #[must_use]
    pub fn picture_line(&self, row: f64) -> (f64, bool) {
        let (line, upright) = self.reducer.image_line(row);
        ((line + 0.5) / self.picture.reduction as f64, upright)
    }
}
