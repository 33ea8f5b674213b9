//! Images and intrinsics of a camera, for data sets.

use serde::{Deserialize, Serialize, Serializer};

use super::{HEADER, Header, RosMessage, TIME};

/// Serialises bytes in one piece, which has the same form as a list and is faster.
fn as_bytes<S: Serializer>(bytes: &[u8], to: S) -> Result<S::Ok, S::Error> {
    to.serialize_bytes(bytes)
}

/// `sensor_msgs/msg/Image`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Image {
    /// Board time, and name of the camera.
    pub header: Header,
    /// Number of rows.
    pub height: u32,
    /// Number of columns.
    pub width: u32,
    /// `rgb8`, `16UC1`, `mono16`.
    pub encoding: String,
    /// 0: little-endian.
    pub is_bigendian: u8,
    /// Bytes of a row.
    pub step: u32,
    /// Pixels, row by row.
    #[serde(serialize_with = "as_bytes")]
    pub data: Vec<u8>,
}

impl RosMessage for Image {
    const TYPE: &'static str = "sensor_msgs/msg/Image";
    const DEFINITION: &'static str = "std_msgs/Header header\nuint32 height\nuint32 width\n\
        string encoding\nuint8 is_bigendian\nuint32 step\nuint8[] data\n";
}

/// `sensor_msgs/msg/CompressedImage`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct CompressedImage {
    /// Board time, and name of the camera.
    pub header: Header,
    /// `jpeg`.
    pub format: String,
    /// Content of the file.
    #[serde(serialize_with = "as_bytes")]
    pub data: Vec<u8>,
}

impl RosMessage for CompressedImage {
    const TYPE: &'static str = "sensor_msgs/msg/CompressedImage";
    const DEFINITION: &'static str = "std_msgs/Header header\nstring format\nuint8[] data\n";
}

/// `sensor_msgs/msg/RegionOfInterest`. All zeros: the whole image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct RegionOfInterest {
    /// First column.
    pub x_offset: u32,
    /// First row.
    pub y_offset: u32,
    /// Number of rows.
    pub height: u32,
    /// Number of columns.
    pub width: u32,
    /// True if this region alone is rectified.
    pub do_rectify: bool,
}

/// `sensor_msgs/msg/CameraInfo`. A `k` of zeros: the intrinsics are unknown.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CameraInfo {
    /// Board time and name of the camera, as in its image.
    pub header: Header,
    /// Number of rows.
    pub height: u32,
    /// Number of columns.
    pub width: u32,
    /// `plumb_bob`, `rational_polynomial`, `equidistant`.
    pub distortion_model: String,
    /// Coefficients of the distortion, in OpenCV's order.
    pub d: Vec<f64>,
    /// Intrinsics by rows.
    pub k: [f64; 9],
    /// Rectification: the identity.
    pub r: [f64; 9],
    /// Projection by rows.
    pub p: [f64; 12],
    /// 0: none.
    pub binning_x: u32,
    /// 0: none.
    pub binning_y: u32,
    /// The whole image.
    pub roi: RegionOfInterest,
}

impl RosMessage for CameraInfo {
    const TYPE: &'static str = "sensor_msgs/msg/CameraInfo";
    const DEFINITION: &'static str = "std_msgs/Header header\nuint32 height\nuint32 width\n\
        string distortion_model\nfloat64[] d\nfloat64[9] k\nfloat64[9] r\nfloat64[12] p\n\
        uint32 binning_x\nuint32 binning_y\nsensor_msgs/RegionOfInterest roi\n";
    const USES: &'static [(&'static str, &'static str)] = &[
        HEADER,
        TIME,
        (
            "sensor_msgs/RegionOfInterest",
            "uint32 x_offset\nuint32 y_offset\nuint32 height\nuint32 width\nbool do_rectify\n",
        ),
    ];
}
