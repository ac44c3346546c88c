use super::*;
use crate::test_random::Random;

const PERIOD_US: u32 = 5_000;

fn frames(n: u32) -> [SbgMessage; 3] {
    [
        SbgMessage::ImuInfo {
            time_us: 4_294_960_000u32.wrapping_add(n * PERIOD_US),
            status: 0x3FF,
            temperature: 2_550,
        },
        SbgMessage::Accelerometer([50, -25, 981]),
        SbgMessage::Gyroscope([125, -500, n as i16]),
    ]
}

fn packet(arrival_ns: i64, message: SbgMessage) -> Packet {
    Packet {
        arrival: Timestamp::from_nanos(arrival_ns),
        bytes: message.emit().emit().to_vec(),
    }
}

fn push_all(decoder: &mut Decoder, messages: &[SbgMessage]) -> Vec<Decoded<SbgReading>> {
    let packets = messages.iter().zip(0..).map(|(m, i)| packet(i, *m));
    packets
        .filter_map(|packet| decoder.push(&packet).unwrap())
        .collect()
}

#[test]
fn three_frames_make_a_sample_whose_time_goes_on_through_the_wrap() {
    let mut decoder = Decoder::new();
    let date = UtcDate {
        year: 26,
        month: 5,
        day: 17,
        hour: 12,
        minute: 34,
        second: 56,
        ten_thousandths: 5000,
    };
    let utc = [
        SbgMessage::UtcTime {
            time_us: 4_294_960_000,
            time_of_week_ms: 345_678_000,
        },
        SbgMessage::UtcDate(date),
    ];
    let messages = [&utc[..], &frames(0), &frames(1), &frames(2)].concat();
    let readings = push_all(&mut decoder, &messages);
    let expected = |n: u64, arrival_ns, utc| Decoded {
        arrival: Timestamp::from_nanos(arrival_ns),
        device_ticks: 4_294_960_000 + n * u64::from(PERIOD_US),
        sample: SbgReading {
            sample: ImuSample {
                angular_velocity_rad_s: [0.125, -0.5, n as f64 / 1000.0],
                specific_force_m_s2: [0.5, -0.25, 9.81],
            },
            status: 0x3FF,
            temperature_celsius: 25.5,
            utc,
        },
    };
    let fix = UtcFix {
        time_us: 4_294_960_000,
        time_of_week_ms: 345_678_000,
        date,
    };
    assert_eq!(
        readings,
        [
            expected(0, 2, Some(fix)),
            expected(1, 5, None),
            expected(2, 8, None)
        ]
    );
    let counters = SbgCounters {
        frames: 11,
        samples: 3,
        ..SbgCounters::default()
    };
    assert_eq!(decoder.counters(), counters);
}

#[test]
fn lost_and_doubled_frames_cost_their_sample_and_are_counted() {
    let mut decoder = Decoder::new();
    let mut messages = Vec::new();
    for n in 0..10 {
        let [info, accelerometer, gyroscope] = frames(n);
        match n {
            3 => messages.extend([info, gyroscope]),
            5 => messages.extend([accelerometer, gyroscope]),
            6 => messages.extend([info, accelerometer, accelerometer, gyroscope]),
            7 => {}
            _ => messages.extend([info, accelerometer, gyroscope]),
        }
    }
    let numbers: Vec<f64> = push_all(&mut decoder, &messages)
        .iter()
        .map(|reading| reading.sample.sample.angular_velocity_rad_s[2] * 1000.0)
        .collect();
    assert_eq!(numbers, [0.0, 1.0, 2.0, 4.0, 6.0, 8.0, 9.0]);
    let counters = decoder.counters();
    assert_eq!((counters.incomplete, counters.stray), (1, 3));
    // Numbers 5 and 7 left a hole in the times; number 3 is counted as incomplete.
    assert_eq!(counters.missing, 2);
    push_all(&mut decoder, &frames(10)[..2]);
    decoder.finish();
    assert_eq!(decoder.counters().incomplete, 2);
}

#[test]
fn others_on_the_bus_and_its_errors_pass_by() {
    let mut decoder = Decoder::new();
    let mut push = |frame: CanFrame| {
        decoder.push(&Packet {
            arrival: Timestamp::default(),
            bytes: frame.emit().to_vec(),
        })
    };
    assert_eq!(push(CanFrame::standard(0x7FF, &[1])), Ok(None));
    let mut error = CanFrame::standard(0, &[0; 8]).emit();
    error[3] = 0x20;
    assert_eq!(push(CanFrame::parse(&error).unwrap()), Ok(None));
    assert!(push(CanFrame::standard(0x120, &[1, 2])).is_err());
    let counters = decoder.counters();
    assert_eq!(
        (counters.foreign, counters.bus_errors, counters.malformed),
        (1, 1, 1)
    );
}

#[test]
fn random_and_mutated_frames_never_panic() {
    let mut random = Random::new(3);
    let mut decoder = Decoder::new();
    for n in 0..20_000u32 {
        let message = frames(n % 50)[(n % 3) as usize];
        let mut packet = packet(0, message);
        if random.below(3) == 0 {
            random.mutate(&mut packet.bytes);
        }
        let _ = decoder.push(&packet);
    }
    assert!(decoder.counters().samples > 1_000);
}

#[test]
fn a_glitch_of_the_time_does_not_make_every_later_sample_look_late() {
    let mut decoder = Decoder::new();
    let mut messages = Vec::new();
    for n in 0..100 {
        let [_, accelerometer, gyroscope] = frames(n);
        let glitch = if n == 20 { 4_999 } else { 0 };
        let info = SbgMessage::ImuInfo {
            time_us: n * PERIOD_US - glitch,
            status: 0,
            temperature: 0,
        };
        messages.extend([info, accelerometer, gyroscope]);
    }
    assert_eq!(push_all(&mut decoder, &messages).len(), 100);
    // The step after the glitch is twice as long as the others.
    assert_eq!(decoder.counters().missing, 1);
}
