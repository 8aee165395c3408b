//! Messages of ROS 2 Jazzy, field by field as their definitions say, with the names and hashes of their types.
//! In CDR there is nothing but the fields: what stands here is the layout.

use ctos::Blob;
use hiroz_cdr::LittleEndian;
use serde::{Deserialize, Serialize, de::DeserializeOwned};

/// The type of a topic or a service.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) struct RosType {
    /// `sensor_msgs::msg::dds_::JointState_`.
    pub name: &'static str,
    /// SHA-256 of its description (REP 2016), as hexadecimal digits.
    pub hash: &'static str,
}

/// A message that is a topic's.
pub(crate) trait Topic: Serialize + DeserializeOwned {
    /// Its type.
    const TYPE: RosType;
}

macro_rules! topic {
    ($message:ident, $name:literal, $hash:literal) => {
        impl Topic for $message {
            const TYPE: RosType = RosType {
                name: $name,
                hash: $hash,
            };
        }
    };
}

/// XCDR1, little endian.
const HEADER: [u8; 4] = [0, 1, 0, 0];
/// No message that is taken is larger, bytes.
const MOST_BYTES: usize = 4 << 20;

/// The bytes of a message.
///
/// # Errors
/// It cannot be written, which no message here is.
pub(crate) fn encode(message: &impl Serialize) -> Result<Vec<u8>, hiroz_cdr::Error> {
    let body = hiroz_cdr::to_vec::<_, LittleEndian>(message, 256)?;
    Ok([&HEADER[..], &body].concat())
}

/// Why bytes are no message.
#[derive(Debug, thiserror::Error)]
pub(crate) enum Unreadable {
    #[error("its encoding is not CDR: it begins with {0:02x?}")]
    Header(Vec<u8>),
    #[error("{0} bytes are more than are taken")]
    Large(usize),
    #[error("{0}")]
    Cdr(#[from] hiroz_cdr::Error),
}

/// Reads a message. Nothing is reserved for what a length says; it must be there.
///
/// # Errors
/// The bytes are none.
pub(crate) fn decode<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, Unreadable> {
    if bytes.len() > MOST_BYTES {
        return Err(Unreadable::Large(bytes.len()));
    }
    let Some((header, body)) = bytes.split_at_checked(HEADER.len()) else {
        return Err(Unreadable::Header(bytes.to_vec()));
    };
    let read = match header {
        // Behind the encoding stand options, which tell of padding at the end.
        [0, 1, ..] => hiroz_cdr::from_bytes::<T, LittleEndian>(body),
        [0, 0, ..] => hiroz_cdr::from_bytes::<T, hiroz_cdr::BigEndian>(body),
        _ => return Err(Unreadable::Header(header.to_vec())),
    };
    Ok(read?.0)
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub(crate) struct Time {
    pub sec: i32,
    pub nanosec: u32,
}

impl Time {
    /// Of ns since 1970.
    pub fn of(unix_ns: u64) -> Self {
        let sec = i32::try_from(unix_ns / 1_000_000_000).unwrap_or(i32::MAX);
        let nanosec = (unix_ns % 1_000_000_000) as u32;
        Self { sec, nanosec }
    }
}

#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(crate) struct Header {
    pub stamp: Time,
    pub frame_id: String,
}

#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(crate) struct JointState {
    pub header: Header,
    pub name: Vec<String>,
    pub position: Vec<f64>,
    pub velocity: Vec<f64>,
    pub effort: Vec<f64>,
}
topic!(
    JointState,
    "sensor_msgs::msg::dds_::JointState_",
    "a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e"
);

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct TransformStamped {
    pub header: Header,
    pub child_frame_id: String,
    /// m.
    pub translation: [f64; 3],
    /// x, y, z, w.
    pub rotation: [f64; 4],
}

#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(crate) struct TFMessage {
    pub transforms: Vec<TransformStamped>,
}
topic!(
    TFMessage,
    "tf2_msgs::msg::dds_::TFMessage_",
    "e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"
);

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Image {
    pub header: Header,
    pub height: u32,
    pub width: u32,
    pub encoding: String,
    pub is_bigendian: u8,
    pub step: u32,
    pub data: Blob,
}
topic!(
    Image,
    "sensor_msgs::msg::dds_::Image_",
    "d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47"
);

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub(crate) struct RegionOfInterest {
    pub x_offset: u32,
    pub y_offset: u32,
    pub height: u32,
    pub width: u32,
    pub do_rectify: bool,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct CameraInfo {
    pub header: Header,
    pub height: u32,
    pub width: u32,
    pub distortion_model: String,
    pub d: Vec<f64>,
    pub k: [f64; 9],
    pub r: [f64; 9],
    pub p: [f64; 12],
    pub binning_x: u32,
    pub binning_y: u32,
    pub roi: RegionOfInterest,
}
topic!(
    CameraInfo,
    "sensor_msgs::msg::dds_::CameraInfo_",
    "b3dfd68ff46c9d56c80fd3bd4ed22c7a4ddce8c8348f2f59c299e73118e7e275"
);

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct KeyValue {
    pub key: String,
    pub value: String,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct DiagnosticStatus {
    /// 0 OK, 1 warning, 2 error, 3 stale.
    pub level: u8,
    pub name: String,
    pub message: String,
    pub hardware_id: String,
    pub values: Vec<KeyValue>,
}

#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(crate) struct DiagnosticArray {
    pub header: Header,
    pub status: Vec<DiagnosticStatus>,
}
topic!(
    DiagnosticArray,
    "diagnostic_msgs::msg::dds_::DiagnosticArray_",
    "5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e"
);

#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(crate) struct JointTrajectoryPoint {
    pub positions: Vec<f64>,
    pub velocities: Vec<f64>,
    pub accelerations: Vec<f64>,
    pub effort: Vec<f64>,
    pub time_from_start: Time,
}

#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(crate) struct JointTrajectory {
    pub header: Header,
    pub joint_names: Vec<String>,
    pub points: Vec<JointTrajectoryPoint>,
}
topic!(
    JointTrajectory,
    "trajectory_msgs::msg::dds_::JointTrajectory_",
    "179b33eba59d676f6d967ac71fe35e7ca2f64b2f3928f4a018cec115e213796e"
);

/// The type of the service whose request has no fields.
pub(crate) const TRIGGER: RosType = RosType {
    name: "std_srvs::srv::dds_::Trigger_",
    hash: "eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f",
};

/// A message without fields has one byte.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub(crate) struct TriggerRequest {
    pub structure_needs_at_least_one_member: u8,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct TriggerResponse {
    pub success: bool,
    pub message: String,
}

#[cfg(test)]
mod tests;
