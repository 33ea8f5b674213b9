//! The cameras' lenses and poses, and the registration of depth images that the user asks for.

use recording::profile::{Intrinsics, Pose};

use super::Extraction;
use super::depth_part::Depth;
use crate::error::ExtractError;
use crate::geometry::calibration::{self, Calibration};
use crate::geometry::lens::Lens;
use crate::geometry::register::{ImageGeometry, Registration};
use crate::geometry::{CameraFacts, Cameras, DepthView, View};
use crate::inputs::PhoneInput;
use crate::report::LossPart;

impl Extraction<'_> {
    /// Returns the cameras and the view of depth images that the user asks for. `video` is the
    /// size of the phone's images.
    pub(super) fn geometry(
        &mut self,
        phone: &PhoneInput,
        video: Option<(u32, u32)>,
        depth: Option<&Depth>,
    ) -> (Cameras, DepthView) {
        let calibration = depth.map_or_else(
            || Err(String::from("there is no depth recording")),
            read_calibration,
        );
        let color_from_imu = self.inputs.color_from_imu;
        let depth_from_imu = calibration
            .as_ref()
            .ok()
            .zip(color_from_imu)
            .map(|(calibration, color)| calibration.color_from_depth.inverse().after(&color));
        let mut cameras = Cameras {
            phone: phone.camera(video),
            ..Cameras::default()
        };
        if let Ok(calibration) = &calibration {
            cameras.depth.intrinsics = calibration.depth.intrinsics.clone();
            let color = calibration.color.as_ref();
            cameras.color.intrinsics = color.and_then(|color| color.intrinsics.clone());
        }
        cameras.color.from_imu = color_from_imu;
        cameras.depth.from_imu = depth_from_imu;
        let Some(view) = self.job.options.view else {
            return (cameras, DepthView::Own);
        };
        let found = calibration.and_then(|calibration| match view {
            View::Color => into_color(&calibration),
            View::Phone => into_phone(&calibration, &cameras.phone, video, depth_from_imu),
        });
        match found {
            Ok(registration) => {
                cameras.depth = match view {
                    View::Phone => cameras.phone.clone(),
                    View::Color => cameras.color.clone(),
                };
                cameras.depth.shutter = None;
                (cameras, DepthView::Registered(Box::new(registration)))
            }
            Err(reason) => {
                self.lose(
                    LossPart::Depth,
                    format!(
                        "depth images are not written, for they cannot be registered as --register asks: {reason}"
                    ),
                );
                (cameras, DepthView::Unavailable)
            }
        }
    }

    /// Writes `cameras.json`, unless nothing is known about any camera.
    pub(super) fn write_cameras(&self, cameras: &Cameras) -> Result<(), ExtractError> {
        if *cameras == Cameras::default() {
            return Ok(());
        }
        let json = serde_json::to_vec_pretty(cameras).map_err(|error| self.failed(error.into()))?;
        self.write("cameras.json", &json)
    }
}

/// Reads the calibration in the depth recording, for the mode and sizes of its images.
fn read_calibration(depth: &Depth) -> Result<Calibration, String> {
    let index = &depth.index;
    let json = index
        .calibration
        .as_ref()
        .ok_or("the depth recording has no calibration.json")?;
    let color = index.color.as_ref().map(|color| color.size);
    let calibration = calibration::read(json, index.mode.as_deref(), color)?;
    if calibration.depth.size == index.size {
        return Ok(calibration);
    }
    Err(format!(
        "depth images are {} × {}, and those of the mode {} × {}",
        index.size.0, index.size.1, calibration.depth.size.0, calibration.depth.size.1
    ))
}

/// Registers depth images into the view of the depth camera's colour camera.
fn into_color(calibration: &Calibration) -> Result<Registration, String> {
    let color = calibration
        .color
        .as_ref()
        .ok_or("the depth camera recorded no colour; give --register phone")?;
    Ok(Registration::new(
        calibration.depth.image(),
        calibration.color_from_depth,
        color.image(),
    ))
}

/// Registers depth images into the view of the phone's camera, whose images have the size
/// `video`.
fn into_phone(
    calibration: &Calibration,
    phone: &CameraFacts,
    video: Option<(u32, u32)>,
    depth_from_imu: Option<Pose>,
) -> Result<Registration, String> {
    let size = video.ok_or("there are no images of the phone")?;
    let intrinsics: &Intrinsics = phone.intrinsics.as_ref().ok_or_else(|| {
        format!(
            "the profile has no intrinsics of the phone (phone.cameras) for images of {} × {}; \
             `profile import-kalibr` writes them",
            size.0, size.1
        )
    })?;
    let from_imu = phone.from_imu.ok_or(
        "the profile does not say where the phone's camera is (phone.from_imu); `profile import-kalibr` \
         writes it",
    )?;
    let depth_from_imu = depth_from_imu.ok_or(
        "the profile does not say where the depth camera is (depth.color_from_imu); `profile \
         import-kalibr` writes it",
    )?;
    let lens = &Lens::from_intrinsics(intrinsics);
    Ok(Registration::new(
        calibration.depth.image(),
        from_imu.after(&depth_from_imu.inverse()),
        ImageGeometry { lens, size },
    ))
}
