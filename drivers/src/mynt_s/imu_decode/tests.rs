use super::*;
use crate::mynt_s::wire::TimeSource;

fn segment(serial: u32, timestamp_us: u64, values: ImuValues) -> ImuSegment {
    ImuSegment {
        serial,
        timestamp_us,
        time_source: TimeSource::Device,
        temperature: 25.0,
        values,
    }
}

fn answer(protocol: ImuProtocol, segments: &[ImuSegment]) -> Packet {
    let response = ImuResponse {
        segments: segments.to_vec(),
    };
    Packet {
        arrival: Timestamp::from_nanos(5),
        bytes: response.emit(protocol).unwrap(),
    }
}

#[test]
fn specific_force_is_interpolated_at_the_gyroscopes_stamps() {
    let acc = |serial, at, z| segment(serial, at, ImuValues::AccelerometerG([0.0, 1.0, z]));
    let gyro = |serial, at, x| segment(serial, at, ImuValues::GyroscopeDegS([x, 0.0, -90.0]));
    let mut decoder = ImuDecoder::new(ImuProtocol::Float);
    let first = [gyro(1, 900, 1.0), acc(2, 1000, 1.0), gyro(3, 2000, 180.0)];
    let second = [acc(4, 5000, 3.0), gyro(5, 5000, 2.0)];
    assert_eq!(
        decoder.push(&answer(ImuProtocol::Float, &first)),
        Ok(vec![])
    );
    let samples = decoder.push(&answer(ImuProtocol::Float, &second)).unwrap();
    assert_eq!(samples.len(), 1);
    let Decoded {
        arrival,
        device_ticks,
        sample,
    } = samples[0];
    assert_eq!((arrival.nanos(), device_ticks), (5, 2000));
    let pi = std::f64::consts::PI;
    assert_eq!(sample.angular_velocity_rad_s, [pi, 0.0, -pi / 2.0]);
    assert_eq!(sample.specific_force_m_s2[..2], [0.0, 9.80665]);
    assert!((sample.specific_force_m_s2[2] - 1.5 * 9.80665).abs() < 1e-12);
    assert_eq!(decoder.counters().unpaired, 1);
}

#[test]
fn integers_are_scaled_by_their_spans_and_repetitions_dropped() {
    let segments = [
        segment(1000, 10, ImuValues::RawAccelerometer([0, 0, 10_923])),
        segment(1001, 10, ImuValues::RawGyroscope([66, -66, 0])),
        segment(1004, 12, ImuValues::RawAccelerometer([0, 0, 10_923])),
    ];
    let mut decoder = ImuDecoder::new(ImuProtocol::Integer);
    let packet = answer(ImuProtocol::Integer, &segments);
    let samples = decoder.push(&packet).unwrap();
    let sample = samples[0].sample;
    assert!((sample.specific_force_m_s2[2] / 9.80665 - 2.0001).abs() < 1e-4);
    assert!((sample.angular_velocity_rad_s[0].to_degrees() - 1.0071).abs() < 1e-4);
    assert_eq!(
        sample.angular_velocity_rad_s[1],
        -sample.angular_velocity_rad_s[0]
    );
    assert_eq!(decoder.last_serial(), 1004);
    assert_eq!(decoder.push(&packet), Ok(vec![]));
    assert_eq!(
        decoder.counters(),
        ImuCounters {
            segments: 3,
            missing: 2,
            duplicated: 3,
            ..Default::default()
        }
    );
}

#[test]
fn paired_segments_need_no_interpolation_and_bad_answers_are_counted() {
    let paired = ImuValues::Paired {
        gyroscope_deg_s: [180.0, 0.0, 0.0],
        accelerometer_g: [0.0, 0.0, 1.0],
    };
    let mut decoder = ImuDecoder::new(ImuProtocol::FloatPaired);
    let mut packet = answer(ImuProtocol::FloatPaired, &[segment(1, 7, paired)]);
    let samples = decoder.push(&packet).unwrap();
    assert_eq!(samples[0].device_ticks, 7);
    assert_eq!(
        samples[0].sample,
        ImuSample {
            angular_velocity_rad_s: [std::f64::consts::PI, 0.0, 0.0],
            specific_force_m_s2: [0.0, 0.0, 9.80665],
        }
    );
    packet.bytes[1] = 1;
    assert!(decoder.push(&packet).is_err());
    assert_eq!(decoder.counters().bad_answers, 1);
}

/// Segments of a unit at 200 Hz for each sensor: accelerometer and gyroscope take turns.
fn segments(from_us: u64, to_us: u64, first_serial: u32) -> Vec<ImuSegment> {
    (from_us..to_us)
        .step_by(2_500)
        .zip(first_serial..)
        .map(|(at_us, serial)| {
            let values = if at_us % 5_000 == 0 {
                ImuValues::AccelerometerG([0.0, 0.0, 1.0])
            } else {
                ImuValues::GyroscopeDegS([0.0, 0.0, at_us as f32])
            };
            segment(serial, at_us, values)
        })
        .collect()
}

fn push_in_answers(decoder: &mut ImuDecoder, segments: &[ImuSegment]) -> Vec<Decoded<ImuSample>> {
    let capacity = ImuResponse::capacity(ImuProtocol::Float);
    segments
        .chunks(capacity)
        .flat_map(|part| decoder.push(&answer(ImuProtocol::Float, part)).unwrap())
        .collect()
}

#[test]
fn a_late_batch_loses_nothing_and_keeps_the_units_stamps() {
    // A host that was busy for a second finds more than one answer can hold.
    let batch = segments(0, 1_000_000, 1);
    assert!(batch.len() > 5 * ImuResponse::capacity(ImuProtocol::Float));
    let mut decoder = ImuDecoder::new(ImuProtocol::Float);
    let samples = push_in_answers(&mut decoder, &batch);
    // The last gyroscope segment waits for the accelerometer's next.
    assert_eq!(samples.len(), 199);
    for (sample, n) in samples.iter().zip(0..) {
        assert_eq!(sample.device_ticks, 2_500 + 5_000 * n);
    }
    let expected = ImuCounters {
        segments: 400,
        ..ImuCounters::default()
    };
    assert_eq!(decoder.counters(), expected);
}

#[test]
fn a_gap_of_45_ms_is_counted_and_is_no_loss_where_the_serials_go_on() {
    let mut decoder = ImuDecoder::new(ImuProtocol::Float);
    let before = segments(0, 500_000, 1);
    let silent = segments(545_000, 1_000_000, 1 + before.len() as u32);
    push_in_answers(&mut decoder, &[before.clone(), silent].concat());
    let counters = decoder.counters();
    assert_eq!((counters.gaps, counters.missing), (1, 0));
    assert_eq!(counters.longest_gap_us, 50_000);

    // The same hole with serials that count on is loss.
    let mut decoder = ImuDecoder::new(ImuProtocol::Float);
    let lost = segments(545_000, 1_000_000, 1 + before.len() as u32 + 18);
    push_in_answers(&mut decoder, &[before, lost].concat());
    assert_eq!(
        (decoder.counters().gaps, decoder.counters().missing),
        (1, 18)
    );
}
