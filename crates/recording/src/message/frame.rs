//! Frames of reference of what sidecars send: each names its own as it likes, `imu` or `cam0`, and so does every other.

use super::schema::{
    BLE_ADVERT, FLUID_PRESSURE, IMAGE, IMU, MAGNETIC_FIELD, NAV_SAT_FIX, ORIENTATION, POSE, VECTOR,
    WIFI_READING, WIFI_SCAN,
};

/// Encapsulation of little-endian CDR, and the stamp and the length of the frame's name behind it.
const HEAD: [u8; 4] = [0, 1, 0, 0];
const NAME_AT: usize = 12;

/// A message on its way: new bytes, and the rest of the old ones behind them.
pub(crate) struct Reframed<'a> {
    pub head: Vec<u8>,
    pub rest: &'a [u8],
}

/// The name of a sidecar's frame in a recording, which is that of no other device.
pub(crate) fn frame_of(device: &str, frame: &str) -> String {
    format!("{device}/{frame}")
}

/// The same message, its frame called `<device>/<frame>`. `None` for messages whose frame is that already or is empty, of types that
/// no sidecar sends, and for those that cannot be read.
pub(crate) fn in_frame_of<'a>(
    device: &str,
    schema_name: &str,
    bytes: &'a [u8],
) -> Option<Reframed<'a>> {
    let body = bytes.strip_prefix(&HEAD)?;
    let length = body.get(8..NAME_AT)?.try_into().ok()?;
    let end = NAME_AT.checked_add(u32::from_le_bytes(length) as usize)?;
    let name = body.get(NAME_AT..end)?.strip_suffix(&[0])?;
    let name = std::str::from_utf8(name).ok()?;
    if name.is_empty() || name.starts_with(&format!("{device}/")) {
        return None;
    }
    let name = frame_of(device, name);
    let mut head = bytes.get(..HEAD.len() + 8)?.to_vec();
    head.extend_from_slice(&u32::try_from(name.len() + 1).ok()?.to_le_bytes());
    head.extend_from_slice(name.as_bytes());
    head.push(0);
    // What follows is as it was from the first number on by whose size all later ones are aligned.
    let rest = if schema_name == NAV_SAT_FIX.name {
        let service = (end + 1).next_multiple_of(2);
        head.push(*body.get(end)?);
        pad(&mut head, 2);
        head.extend_from_slice(body.get(service..service + 2)?);
        pad(&mut head, 8);
        (service + 2).next_multiple_of(8)
    } else {
        let alignment = alignment(schema_name)?;
        pad(&mut head, alignment);
        end.next_multiple_of(alignment)
    };
    let rest = body.get(rest..)?;
    Some(Reframed { head, rest })
}

/// Alignment of the largest number in a message, which is that of the first one behind its header.
fn alignment(schema_name: &str) -> Option<usize> {
    let is = |schemas: &[super::Schema]| schemas.iter().any(|s| s.name == schema_name);
    if is(&[
        IMU,
        MAGNETIC_FIELD,
        FLUID_PRESSURE,
        VECTOR,
        ORIENTATION,
        POSE,
    ]) {
        Some(8)
    } else if is(&[IMAGE, WIFI_READING, WIFI_SCAN, BLE_ADVERT]) {
        Some(4)
    } else {
        None
    }
}

/// Zeros up to a multiple of `alignment`, counted from behind the encapsulation.
fn pad(head: &mut Vec<u8>, alignment: usize) {
    let body = (head.len() - HEAD.len()).next_multiple_of(alignment);
    head.resize(HEAD.len() + body, 0);
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::Se3;
    use lsfb_types::{Image, ImuSample, Timestamp};

    use super::*;
    use crate::message::*;

    const TIME: Timestamp = Timestamp::from_nanos(1_772_359_200_123_456_789);

    /// Each type with names of all lengths modulo eight: as if it had been encoded with that frame.
    #[test]
    fn a_message_in_another_frame_is_as_if_it_had_been_written_there() {
        let imu = ImuSample {
            angular_velocity_rad_s: [0.1, 0.2, 0.3],
            specific_force_m_s2: [1.0, 2.0, 9.0],
        };
        let image = Image {
            width: 3,
            height: 2,
            pixels: vec![1, 2, 3, 4, 5, 6],
            exposure_ns: 0,
            frame_id: 0,
        };
        let gnss = GnssReading::default();
        let wifi = WifiReading::default();
        let ble = BleAdvert::default();
        type Encode<'a> = &'a dyn Fn(&str) -> Vec<u8>;
        let scan = WifiScan::default();
        let encoders: [(Schema, Encode<'_>); 11] = [
            (IMU, &|f| encode_imu(TIME, f, &imu, ImuVariance::UNKNOWN)),
            (IMAGE, &|f| encode_image(TIME, f, &image)),
            (MAGNETIC_FIELD, &|f| {
                encode_magnetic(TIME, f, &MagneticSample::default())
            }),
            (FLUID_PRESSURE, &|f| {
                encode_pressure(TIME, f, &PressureSample::default())
            }),
            (NAV_SAT_FIX, &|f| encode_gnss(TIME, f, &gnss)),
            (WIFI_READING, &|f| encode_wifi(TIME, f, &wifi)),
            (BLE_ADVERT, &|f| encode_ble(TIME, f, &ble)),
            (WIFI_SCAN, &|f| encode_wifi_scan(TIME, f, &scan)),
            (VECTOR, &|f| encode_vector(TIME, f, &[1.0, 2.0, 3.0])),
            (ORIENTATION, &|f| {
                encode_orientation(TIME, f, &[0.0, 0.0, 0.0, 1.0])
            }),
            (POSE, &|f| encode_pose(TIME, f, &Se3::identity())),
        ];
        for (schema, encode) in encoders {
            for length in 1..20 {
                for device in ["a", "glasses", "phone-17", "iphone"] {
                    let frame = "f".repeat(length);
                    let own = frame_of(device, &frame);
                    let bytes = encode(&frame);
                    let Reframed { head, rest } =
                        in_frame_of(device, schema.name, &bytes).expect("a frame");
                    assert_eq!(
                        [&head, rest].concat(),
                        encode(&own),
                        "{} {own}",
                        schema.name
                    );
                    assert!(in_frame_of(device, schema.name, &encode(&own)).is_none());
                }
            }
        }
    }

    #[test]
    fn what_cannot_be_read_stays_as_it_is() {
        let bytes = encode_pressure(TIME, "imu", &PressureSample::default());
        for length in 0..bytes.len() {
            let cut = &bytes[..length];
            if let Some(Reframed { head, rest }) = in_frame_of("a", FLUID_PRESSURE.name, cut) {
                // Cut behind its header: the numbers that there are stay.
                assert!(head.len() + rest.len() <= length + 8 && length >= 20);
            }
        }
        assert!(in_frame_of("a", "x/msg/X", &bytes).is_none());
        let unnamed = encode_pressure(TIME, "", &PressureSample::default());
        assert!(in_frame_of("a", FLUID_PRESSURE.name, &unnamed).is_none());
    }
}
