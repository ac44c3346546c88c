use super::*;
use crate::transport::trace::Tracing;

const MS: i64 = 1_000_000;

/// Packets a millisecond apart, each with its number in four bytes.
struct Numbers {
    next: u32,
    end: u32,
}

fn numbers(end: u32) -> Numbers {
    Numbers { next: 0, end }
}

impl PacketSource for Numbers {
    fn recv(&mut self, _timeout: Duration) -> Result<Option<Packet>, Error> {
        if self.next == self.end {
            return Err(Error::EndOfStream {
                device: "numbers".to_owned(),
            });
        }
        let bytes = self.next.to_le_bytes().to_vec();
        let arrival = Timestamp::from_nanos(1_000 * MS + i64::from(self.next) * MS);
        self.next += 1;
        Ok(Some(Packet { arrival, bytes }))
    }
}

#[derive(Debug, PartialEq)]
struct Delivered {
    number: u32,
    /// After the first packet of the source, milliseconds.
    at_ms: i64,
}

fn seen(packet: &Packet) -> Delivered {
    Delivered {
        number: u32::from_le_bytes(packet.bytes.as_slice().try_into().unwrap()),
        at_ms: (packet.arrival.nanos() - 1_000 * MS) / MS,
    }
}

/// All packets until the end, and the end.
fn drain(source: &mut impl PacketSource) -> (Vec<Packet>, Error) {
    let mut packets = Vec::new();
    loop {
        match source.recv(Duration::ZERO) {
            Ok(packet) => packets.push(packet.expect("a file never waits")),
            Err(error) => return (packets, error),
        }
    }
}

fn suffer(count: u32, fault: Fault) -> (Vec<Delivered>, FaultCounts) {
    let mut faulty = Faulty::new(numbers(count), fault, 7);
    let (packets, end) = drain(&mut faulty);
    assert!(matches!(end, Error::EndOfStream { .. }), "{end}");
    (packets.iter().map(seen).collect(), faulty.counts())
}

#[test]
fn dropped_packets_are_gone_and_counted() {
    let (packets, counts) = suffer(2_000, Fault::Drop { probability: 0.1 });
    assert_eq!(counts.packets, 2_000);
    assert_eq!(packets.len() as u64, 2_000 - counts.affected);
    assert!((150..250).contains(&counts.affected), "{counts:?}");
    assert!(packets.windows(2).all(|w| w[0].number < w[1].number));
    assert_eq!(suffer(50, Fault::Drop { probability: 0.0 }).0.len(), 50);
    assert_eq!(suffer(50, Fault::Drop { probability: 1.0 }).0.len(), 0);
}

#[test]
fn doubled_packets_follow_each_other() {
    let (packets, counts) = suffer(500, Fault::Duplicate { probability: 0.2 });
    assert_eq!(packets.len() as u64, 500 + counts.affected);
    let doubled = packets.windows(2).filter(|w| w[0] == w[1]).count();
    assert_eq!(doubled as u64, counts.affected);
    assert!(counts.affected > 50);
}

#[test]
fn an_overtaken_packet_comes_after_as_many_as_were_asked_for() {
    let fault = Fault::Reorder {
        probability: 0.02,
        places: 3,
    };
    let (packets, counts) = suffer(1_000, fault);
    assert_eq!(packets.len(), 1_000);
    assert!(counts.affected > 5);
    // Nobody arrives before who stands in front of him.
    assert!(packets.windows(2).all(|w| w[0].at_ms <= w[1].at_ms));
    let mut numbers: Vec<u32> = packets.iter().map(|p| p.number).collect();
    let overtaken = packets
        .iter()
        .filter(|p| i64::from(p.number) < p.at_ms)
        .collect::<Vec<_>>();
    // A few at the end have nobody left to overtake them.
    assert!(overtaken.len() as u64 + 3 >= counts.affected);
    for late in overtaken {
        let place = packets
            .iter()
            .position(|p| p.number == late.number)
            .unwrap();
        let passed = packets[..place]
            .iter()
            .filter(|p| p.number > late.number)
            .count();
        assert!((3..=5).contains(&passed), "{late:?} {passed}");
    }
    numbers.sort_unstable();
    assert!(numbers.into_iter().eq(0..1_000));
}

#[test]
fn damage_keeps_the_length_and_truncation_the_beginning() {
    let whole = |n: u32| n.to_le_bytes();
    let corrupt = Fault::Corrupt {
        probability: 0.5,
        bits: 1,
    };
    let mut faulty = Faulty::new(numbers(400), corrupt, 1);
    let (packets, _) = drain(&mut faulty);
    let flipped = packets.iter().zip(0..).map(|(packet, n)| {
        assert_eq!(packet.bytes.len(), 4);
        let bits = packet.bytes.iter().zip(whole(n));
        bits.map(|(a, b)| (a ^ b).count_ones()).sum::<u32>()
    });
    assert_eq!(u64::from(flipped.sum::<u32>()), faulty.counts().affected);

    let mut faulty = Faulty::new(numbers(400), Fault::Truncate { probability: 0.5 }, 1);
    let (packets, _) = drain(&mut faulty);
    let mut cut = 0;
    for (packet, n) in packets.iter().zip(0..) {
        assert!(whole(n).starts_with(&packet.bytes));
        cut += u64::from(packet.bytes.len() < 4);
    }
    assert_eq!(cut, faulty.counts().affected);
    assert!(cut > 100);
}

#[test]
fn delayed_packets_keep_their_order() {
    let fault = Fault::Delay {
        delay_ns: 5 * MS,
        jitter_ns: 10 * MS,
    };
    let (packets, _) = suffer(500, fault);
    assert!(packets.iter().map(|p| p.number).eq(0..500));
    assert!(packets.windows(2).all(|w| w[0].at_ms <= w[1].at_ms));
    let late: Vec<i64> = packets
        .iter()
        .map(|p| p.at_ms - i64::from(p.number))
        .collect();
    assert!(late.iter().all(|late| (5..=15).contains(late)), "{late:?}");
    assert!(late.iter().max() > late.iter().min());
}

#[test]
fn a_stall_ends_in_a_batch() {
    let fault = Fault::Stall {
        start_ns: 10 * MS,
        length_ns: 45 * MS,
        period_ns: 100 * MS,
    };
    let (packets, counts) = suffer(200, fault);
    assert_eq!(counts.affected, 90);
    for (n, packet) in packets.iter().enumerate() {
        let n = n as i64;
        let expected = match n {
            10..55 => 55,
            110..155 => 155,
            _ => n,
        };
        assert_eq!((i64::from(packet.number), packet.at_ms), (n, expected));
    }
    // What is held back at the end is not lost.
    let unfinished = Fault::Stall {
        start_ns: 150 * MS,
        length_ns: 1_000 * MS,
        period_ns: 0,
    };
    assert_eq!(suffer(200, unfinished).0.len(), 200);
}

#[test]
fn a_disconnected_device_stays_lost() {
    let fault = Fault::Disconnect { after_ns: 20 * MS };
    let mut faulty = Faulty::new(numbers(100), fault, 0);
    let (packets, error) = drain(&mut faulty);
    assert_eq!(packets.len(), 20);
    assert!(matches!(error, Error::Lost { .. }), "{error}");
    let again = faulty.recv(Duration::ZERO).unwrap_err();
    assert!(matches!(again, Error::Lost { .. }), "{again}");
}

#[test]
fn a_clock_step_moves_everything_after_it() {
    for step_ms in [1_000, -1_000] {
        let fault = Fault::ClockStep {
            after_ns: 30 * MS,
            step_ns: step_ms * MS,
        };
        let (packets, counts) = suffer(60, fault);
        assert_eq!(counts.affected, 30);
        for (packet, n) in packets.iter().zip(0..) {
            let stepped = if n < 30 { 0 } else { step_ms };
            assert_eq!((i64::from(packet.number), packet.at_ms), (n, n + stepped));
        }
    }
}

#[test]
fn the_same_seed_does_the_same_and_faults_combine() {
    let chain = |seed| {
        let dropping = Faulty::new(numbers(300), Fault::Drop { probability: 0.1 }, seed);
        let doubling = Faulty::new(dropping, Fault::Duplicate { probability: 0.1 }, seed + 1);
        let reorder = Fault::Reorder {
            probability: 0.1,
            places: 2,
        };
        let mut all = Faulty::new(Tracing::new(doubling, Vec::new()), reorder, seed + 2);
        let (packets, _) = drain(&mut all);
        let passed = all.counts().packets;
        let doubling = all.source().source();
        let dropped = doubling.source().counts().affected;
        assert_eq!(passed, 300 - dropped + doubling.counts().affected);
        packets
    };
    assert_eq!(chain(5), chain(5));
    assert_ne!(chain(5), chain(6));
}
