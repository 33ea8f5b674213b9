//! Index files of each sequence, which list the written images.

use std::path::Path;

use super::Extraction;
use crate::depth::depth_clock::PulseTime;
use crate::error::ExtractError;
use crate::frames::pairs::Pair;
use crate::frames::{CameraFrame, ColorFrame, DepthFrame};
use crate::inputs::board_data::{Reference, TimePair};
use crate::layout::{DataSetInfo, ImageKind, ImageRow, SequenceTables, file_names};
use crate::output::images::{DepthOutcome, VideoOutcome};
use crate::output::sample_pairs;
use crate::output::sequences::Sequences;
use crate::report::SequenceReport;

/// Tables and written images of all sequences.
pub(super) struct Written<'a> {
    pub(super) pulses: &'a [PulseTime],
    pub(super) times: &'a [TimePair],
    pub(super) color: &'a [ColorFrame],
    pub(super) depth: &'a [DepthFrame],
    pub(super) camera: &'a [CameraFrame],
    pub(super) pairs: &'a [Pair],
    pub(super) video: Option<&'a VideoOutcome>,
    pub(super) images: Option<&'a DepthOutcome>,
}

impl Extraction<'_> {
    /// Writes the index files of each sequence below a folder of the output.
    pub(super) fn finish_sequences(
        &mut self,
        below: &Path,
        sequences: &Sequences,
        written: &Written<'_>,
        facts: &DataSetInfo,
    ) -> Result<Vec<SequenceReport>, ExtractError> {
        self.check_stop()?;
        let layout = self.layout();
        let references = written.times.iter().map(|pair| &pair.of).collect();
        let lidar = self.inputs.lidar.as_deref();
        let (names, longer) = file_names(layout, &references, lidar);
        for (name, file) in longer {
            self.remarks.push(format!(
                "another name is the same as {name:?} in the names of files: its times are in {file}"
            ));
        }
        let mut reports = Vec::new();
        let mut drawn_from = 0;
        for sequence in 0..sequences.count() {
            let mut tables = self.tables_of(sequence, sequences, written);
            let here = |of: &Reference| tables.times.iter().any(|pair| pair.of == *of);
            let here = names.iter().filter(|(of, _)| here(of));
            tables.names = here.map(|(&of, name)| (of, name.clone())).collect();
            let folder = sequences.folder(sequence);
            let data = self.output.out.join(below).join(&folder);
            // Drawn before the format may remove the images, for the sequence with most pairs.
            if tables.pairs.len() > drawn_from && self.draw_samples(&data, &tables)? {
                drawn_from = tables.pairs.len();
            }
            layout
                .finish(&data, &tables, facts)
                .map_err(|error| self.failed(error))?;
            let joined = layout.joined().map(|name| below.join(&folder).join(name));
            self.joined.extend(joined);
            let folder = folder.display().to_string();
            reports.push(SequenceReport {
                folder: if folder.is_empty() {
                    ".".into()
                } else {
                    folder
                },
                color: tables.color.len(),
                depth: tables.depth.len(),
                pairs: tables.pairs.len(),
            });
        }
        Ok(reports)
    }

    /// Draws sample pairs for the report, and returns true if the images are there.
    fn draw_samples(
        &mut self,
        data: &Path,
        tables: &SequenceTables<'_>,
    ) -> Result<bool, ExtractError> {
        let pairs = sample_pairs::samples(data, tables);
        if pairs.iter().any(|(color, _)| !color.exists()) {
            return Ok(false);
        }
        match sample_pairs::draw(&pairs) {
            Ok(svg) => self.write(sample_pairs::FILE, svg.as_bytes())?,
            // The data set is complete without the drawing.
            Err(error) => self
                .remarks
                .push(format!("the report has no sample pairs: {error}")),
        }
        Ok(true)
    }

    /// Returns the written images, pairs and pairs of times of one sequence.
    fn tables_of<'a>(
        &self,
        sequence: usize,
        sequences: &Sequences,
        written: &Written<'a>,
    ) -> SequenceTables<'a> {
        let layout = self.layout();
        let decoded = written.video.map_or(0, |video| video.decoded);
        let listed = |list: &[usize], index: usize| list.binary_search(&index).is_ok();
        let row = |kind, at, own| {
            let path = layout.image_path(kind, at)?;
            Some(ImageRow { at, own, path })
        };
        let mut tables = SequenceTables {
            unfinished: self.unfinished,
            ..SequenceTables::default()
        };
        // Positions in this sequence's lists, by position in the whole tables.
        let mut color_places = vec![None; written.color.len()];
        let mut depth_places = vec![None; written.depth.len()];
        for (index, frame) in written.color.iter().enumerate() {
            let there = frame.image.is_some_and(|image| (image as u64) < decoded);
            if there && sequences.at(frame.at) == sequence {
                color_places[index] = Some(tables.color.len());
                let row = row(ImageKind::Color, frame.at, frame.phone.0);
                tables.color.extend(row);
            }
        }
        for (index, frame) in written.depth.iter().enumerate() {
            let (Some(images), Some(at)) = (written.images, frame.at) else {
                continue;
            };
            let there = frame.is_used() && !listed(&images.broken, index);
            if !there || sequences.at(at) != sequence {
                continue;
            }
            depth_places[index] = Some(tables.depth.len());
            let own = frame.device.0;
            tables.depth.extend(row(ImageKind::Depth, at, own));
            if listed(&images.infrared, index) {
                tables.infrared.extend(row(ImageKind::Infrared, at, own));
            }
        }
        for (index, frame) in written.camera.iter().enumerate() {
            let there = written
                .images
                .is_some_and(|images| listed(&images.color, index));
            let at = frame.at.filter(|&at| there && sequences.at(at) == sequence);
            let row = at.and_then(|at| row(ImageKind::Camera, at, frame.device.0));
            tables.camera.extend(row);
        }
        let place = |pair: &Pair| {
            let color = *color_places.get(pair.color)?;
            let depth = *depth_places.get(pair.depth)?;
            color.zip(depth)
        };
        tables.pairs = written.pairs.iter().filter_map(place).collect();
        let pulses = written.pulses.iter().enumerate();
        let pulses = pulses.filter(|(_, pulse)| sequences.at(pulse.at) == sequence);
        tables.pulses = pulses.collect();
        let of_this = |pair: &&TimePair| sequences.at(pair.stamp) == sequence;
        tables.times = written.times.iter().filter(of_this).collect();
        tables
    }
}
