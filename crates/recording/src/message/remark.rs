use lsfb_types::Timestamp;

use crate::cdr::{CdrError, CdrReader, CdrWriter};
use crate::topic;

/// `lsfb_msgs/msg/Remark`: what the operator says while recording.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Remark {
    /// What it is about: `note`, `control-point`, …
    pub kind: String,
    /// The words, or the name of the point.
    pub text: String,
    /// Where the rig was, in the world of the live odometry, metres; `None` where that was not known.
    pub position_in_world_m: Option<[f64; 3]>,
}

/// `lsfb_msgs/msg/Remark`; a position that is not known is NaN.
pub fn encode_remark(time: Timestamp, remark: &Remark) -> Vec<u8> {
    let mut w = CdrWriter::with_capacity(96 + remark.kind.len() + remark.text.len());
    w.header(time, topic::RIG_FRAME);
    w.string(&remark.kind);
    w.string(&remark.text);
    w.f64s(&remark.position_in_world_m.unwrap_or([f64::NAN; 3]));
    w.finish()
}

/// A `lsfb_msgs/msg/Remark`.
pub fn decode_remark(bytes: &[u8]) -> Result<Remark, CdrError> {
    let mut r = CdrReader::new(bytes)?;
    r.header()?;
    let kind = r.string("kind")?.to_owned();
    let text = r.string("text")?.to_owned();
    let position = [r.f64("x")?, r.f64("y")?, r.f64("z")?];
    Ok(Remark {
        kind,
        text,
        position_in_world_m: position.iter().all(|v| v.is_finite()).then_some(position),
    })
}
