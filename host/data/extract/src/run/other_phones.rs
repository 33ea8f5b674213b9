//! The other phones: the same tables, images and samples as of the phone that the
//! trigger was aligned to, each in `phones/NAME` of the output.

use super::index_files::Written;
use super::phone_part::Phone;
use super::{Extraction, find_pairs, rate_of};
use crate::constants::Constants;
use crate::error::ExtractError;
use crate::geometry::Cameras;
use crate::inputs::PhoneInput;
use crate::inputs::survey::Survey;
use crate::layout::DataSetInfo;
use crate::output::sequences::Sequences;
use crate::output::tables::{self, DepthFrame};
use crate::report::OtherReport;

impl Extraction<'_> {
    /// Extracts one of them. `depth_center` (ns) is from pulse to depth timestamp.
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
        let sigma = self.sigma_of_pairs(phone.as_ref(), input);
        let folder = self.output.out.join(&input.folder);
        let known = input.camera(None);
        tables::write_phone(&folder, (color, known.shutter), (&pairs, &sigma), depth)
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
            // Depth, board and the pairs of images stand with the first phone.
            let written = Written {
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
        let grid = self.against_grid(color, survey, &constants);
        let clock = phone.as_ref().and_then(Phone::clock_report);
        Ok(OtherReport {
            name: input.name.clone().unwrap_or_default(),
            phone: phone
                .as_ref()
                .map(|phone| phone.report(video.as_ref(), &imu)),
            pairs: self.pairs_report(&pairs, color, (input, clock.as_ref())),
            clock,
            grid,
            constants,
        })
    }
}
