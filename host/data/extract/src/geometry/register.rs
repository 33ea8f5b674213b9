//! Registration: depth images as another camera would see them.
//!
//! Each pixel of depth is a point in space, which the other camera's pose and lens project to
//! its image. Between neighbours on one surface, depth is interpolated over
//! the pixels of the other image; of several points on a pixel, the nearest
//! counts. Pixels that the depth camera did not see are 0.

use rayon::prelude::*;
use recording::profile::Pose;

use super::lens::Lens;

/// Largest relative difference in depth between neighbours on one surface.
const JUMP: f32 = 0.05;
/// Longest side of a triangle that is filled, pixels: no two neighbours of a
/// depth image are farther apart.
const LARGEST: f32 = 64.0;

/// Lens and image size of a camera.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ImageGeometry<'a> {
    pub(crate) lens: &'a Lens,
    /// Width and height of the images in pixels.
    pub(crate) size: (u32, u32),
}

/// Registration of depth images from one camera into the view of another.
#[derive(Clone, Debug)]
pub(crate) struct Registration {
    size: (u32, u32),
    rays: Vec<Option<[f32; 2]>>,
    pose: Pose,
    lens: Lens,
    /// Width and height of the registered images.
    pub(crate) out: (u32, u32),
}

/// A point in the registered image: column, row, and depth in mm.
type Seen = Option<[f32; 3]>;

impl Registration {
    /// Creates the registration from one camera to another; `pose` leads from the frame of the
    /// first to that of the second.
    pub(crate) fn new(from: ImageGeometry<'_>, pose: Pose, to: ImageGeometry<'_>) -> Self {
        let size = from.size;
        let ray = |index: u32| {
            let pixel = [f64::from(index % size.0), f64::from(index / size.0)];
            let [x, y] = from.lens.unproject(pixel)?;
            Some([x as f32, y as f32])
        };
        let rays = (0..size.0 * size.1).into_par_iter().map(ray).collect();
        Self {
            size,
            rays,
            pose,
            lens: *to.lens,
            out: to.size,
        }
    }

    /// Registers an image of big-endian 16-bit millimetres; returns one in the same form.
    pub(crate) fn apply(&self, millimetres: &[u8]) -> Vec<u8> {
        let (rotation, way) = (self.pose.rotation(), self.pose.translation());
        let see = |(bytes, ray): (&[u8], &Option<[f32; 2]>)| -> Seen {
            let depth = f64::from(u16::from_be_bytes([bytes[0], bytes[1]]));
            let [x, y] = ray.filter(|_| depth > 0.0)?.map(f64::from);
            let point = [x * depth, y * depth, depth];
            let [x, y, z] = [0, 1, 2].map(|row| {
                let [a, b, c] = rotation[row];
                a * point[0] + b * point[1] + c * point[2] + 1000.0 * way[row]
            });
            if z <= 1.0 {
                return None;
            }
            let [column, row] = self.lens.project([x / z, y / z])?;
            Some([column as f32, row as f32, z as f32])
        };
        let seen: Vec<Seen> = millimetres
            .chunks_exact(2)
            .zip(&self.rays)
            .map(see)
            .collect();
        let mut nearest = vec![f32::INFINITY; self.out.0 as usize * self.out.1 as usize];
        for point in seen.iter().flatten() {
            self.put(&mut nearest, point[0].round(), point[1].round(), point[2]);
        }
        let width = self.size.0 as usize;
        for (upper, lower) in seen.chunks(width).zip(seen.chunks(width).skip(1)) {
            for (above, below) in upper.windows(2).zip(lower.windows(2)) {
                self.fill(&mut nearest, [above[0], above[1], below[0]]);
                self.fill(&mut nearest, [above[1], below[1], below[0]]);
            }
        }
        nearest
            .iter()
            .flat_map(|&depth| {
                let depth = if depth <= f32::from(u16::MAX) {
                    depth
                } else {
                    0.0
                };
                (depth.round() as u16).to_be_bytes()
            })
            .collect()
    }

    /// Sets a pixel unless a nearer point is on it.
    fn put(&self, nearest: &mut [f32], column: f32, row: f32, depth: f32) {
        let (width, height) = self.out;
        if column >= 0.0 && row >= 0.0 && column < width as f32 && row < height as f32 {
            let place = row as usize * width as usize + column as usize;
            if let Some(old) = nearest.get_mut(place) {
                *old = old.min(depth);
            }
        }
    }

    /// Fills the pixels between three neighbours on one surface.
    fn fill(&self, nearest: &mut [f32], corners: [Seen; 3]) {
        let [Some(a), Some(b), Some(c)] = corners else {
            return;
        };
        let bounds = |axis: usize| {
            let low = a[axis].min(b[axis]).min(c[axis]);
            (low, a[axis].max(b[axis]).max(c[axis]))
        };
        let ((left, right), (top, bottom), (near, far)) = (bounds(0), bounds(1), bounds(2));
        if far - near > JUMP * near || right - left > LARGEST || bottom - top > LARGEST {
            return;
        }
        let area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
        if area.abs() < 1e-6 {
            return;
        }
        let (width, height) = (self.out.0 as f32, self.out.1 as f32);
        let mut row = top.ceil().max(0.0);
        while row <= bottom.min(height - 1.0) {
            let mut column = left.ceil().max(0.0);
            while column <= right.min(width - 1.0) {
                let of_b = ((column - a[0]) * (c[1] - a[1]) - (row - a[1]) * (c[0] - a[0])) / area;
                let of_c = ((b[0] - a[0]) * (row - a[1]) - (b[1] - a[1]) * (column - a[0])) / area;
                let of_a = 1.0 - of_b - of_c;
                if of_a >= 0.0 && of_b >= 0.0 && of_c >= 0.0 {
                    let depth = of_a * a[2] + of_b * b[2] + of_c * c[2];
                    self.put(nearest, column, row, depth);
                }
                column += 1.0;
            }
            row += 1.0;
        }
    }
}

#[cfg(test)]
mod tests {
    use recording::profile::{DistortionModel, Intrinsics};

    use super::*;

    fn pinhole(width: u32, height: u32, focal: f64) -> Lens {
        Lens::from_intrinsics(&Intrinsics {
            width,
            height,
            focal: [focal; 2],
            center: [0.5 * f64::from(width - 1), 0.5 * f64::from(height - 1)],
            distortion: DistortionModel::None,
            coefficients: Vec::new(),
        })
    }

    fn identity(way: [f64; 3]) -> Pose {
        Pose::new([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], way)
    }

    fn pixel(image: &[u8], width: u32, column: u32, row: u32) -> u16 {
        let at = 2 * (row * width + column) as usize;
        u16::from_be_bytes([image[at], image[at + 1]])
    }

    #[test]
    fn a_box_moves_by_the_baseline_and_hides_the_wall_behind_it() {
        let (small, large) = (pinhole(64, 48, 60.0), pinhole(160, 120, 150.0));
        // The other camera is 100 mm to the left, so everything moves right by 150 · 100 / z.
        let registration = Registration::new(
            ImageGeometry {
                lens: &small,
                size: (64, 48),
            },
            identity([0.1, 0.0, 0.05]),
            ImageGeometry {
                lens: &large,
                size: (160, 120),
            },
        );
        let mut image = vec![0; 64 * 48 * 2];
        for (index, bytes) in image.chunks_exact_mut(2).enumerate() {
            // A box of 1 m in front of a wall of 3 m.
            let near = (24..40).contains(&(index % 64)) && (16..32).contains(&(index / 64));
            bytes.copy_from_slice(&(if near { 1_000_u16 } else { 3_000 }).to_be_bytes());
        }
        let seen = registration.apply(&image);
        assert_eq!(seen.len(), 160 * 120 * 2);
        // The box is 150 · 0.1 / 1.05 = 14.3 pixels to the right of its position, without holes.
        let box_columns = (80 - 19 + 14 + 2)..(80 + 19 + 14 - 2);
        for column in box_columns {
            assert_eq!(pixel(&seen, 160, column, 60), 1_050, "{column}");
        }
        assert_eq!(pixel(&seen, 160, 30, 60), 3_050);
        // Next to it lies an area that the depth camera could not see.
        assert_eq!(pixel(&seen, 160, 70, 60), 0);
        // An empty image stays empty.
        assert!(
            registration
                .apply(&vec![0; 64 * 48 * 2])
                .iter()
                .all(|&byte| byte == 0)
        );
    }
}
