//! The other phones: the same tables, images and samples as for the phone that the
//! trigger was aligned to, each in `phones/NAME` of the output.

use super::index_files::Written;
use super::phone_part::Phone;
use super::{Extraction, find_pairs, phone_tables, rate_of};
use crate::constants::Constants;
use crate::error::ExtractError;
use crate::frames::DepthFrame;
use crate::geometry::Cameras;
use crate::inputs::PhoneInput;
use crate::inputs::survey::Survey;
use crate::layout::DataSetInfo;
use crate::output::sequences::Sequences;
use crate::report::OtherReport;

impl Extraction<'_> {
    /// Extracts one of the other phones. `depth_center` is the time from pulse to depth
    /// timestamp, ns.
    pub(super) fn other_phone(
        &mut self,
        input: &PhoneInput,
        survey: &Survey,
        sequences: &Sequences,
        depth: &[DepthFrame],
        depth_center: i64,
    ) -> Result<OtherReport, ExtractError> {
        let constants = Constants {
            depth_center_ns: depth_center,
            ..input.constants
        };
        let phone = self.read_phone(input, survey)?;
        let color = phone.as_ref().map_or(&[][..], |phone| &phone.frames);
        let pairs = self.aligned_pairs(find_pairs(color, depth, survey), color, input);
        phone_tables(phone.as_ref(), input, depth, &pairs)
            .write(&self.output.out.join(&input.folder))
            .map_err(|error| self.failed(error))?;
        let video = self.write_phone_images(input, phone.as_ref(), sequences)?;
        let size = video.as_ref().and_then(|video| video.size);
        let imu = self.write_phone_imu(input, phone.as_ref(), sequences)?;
        if phone.is_some() {
            let facts = DataSetInfo {
                color_rate: rate_of(color.iter().map(|frame| frame.at)),
                phone_imu_rate: imu.rate,
                color_size: size,
                constants,
                cameras: Cameras {
                    phone: input.camera(size),
                    ..Cameras::default()
                },
                ..DataSetInfo::default()
            };
            // Depth, board and the pairs of images are with the first phone.
            let written = Written {
                pulses: &[],
                times: &[],
                color,
                depth: &[],
                camera: &[],
                pairs: &[],
                video: video.as_ref(),
                images: None,
            };
            self.finish_sequences(&input.folder, sequences, &written, &facts)?;
        }
        let grid = self.trigger_offset(color, survey, &constants);
        let clock = phone.as_ref().and_then(Phone::clock_report);
        Ok(OtherReport {
            name: input.name.clone().unwrap_or_default(),
            phone: phone
                .as_ref()
                .map(|phone| phone.report(video.as_ref(), &imu)),
            pairs: self.pairs_report(&pairs, color, input, clock.as_ref()),
            clock,
            grid,
            constants,
        })
    }
}
