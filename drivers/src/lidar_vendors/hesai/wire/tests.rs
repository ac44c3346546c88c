use super::*;

/// First and last bytes of XT32, Pandar64 and QT64 packets as the sensors sent them.
const REAL: [(Model, &[u8], &str); 3] = [
    (
        Model::Xt32,
        &[0xEE, 0xFF, 6, 1, 0, 0, 0x20, 8, 1, 4, 2, 1],
        "000086f107830100010039570277071903131d9d720900426c9a0400",
    ),
    (
        Model::Pandar64,
        &[0xEE, 0xFF, 0x40, 6, 0, 4, 0, 0],
        "7634086e6e0000005702bde90e0039427806190c020989b32300",
    ),
    (
        Model::Qt64,
        &[0xEE, 0xFF, 3, 1, 0, 0, 0x40, 4, 1, 4, 2, 1],
        "00000000000000005802aa7b0c003b427509060e1f1639860200",
    ),
];

fn bytes(hex: &str) -> Vec<u8> {
    let pairs = hex.as_bytes().chunks(2);
    pairs
        .map(|pair| u8::from_str_radix(std::str::from_utf8(pair).unwrap(), 16).unwrap())
        .collect()
}

#[test]
fn heads_and_tails_of_real_packets_say_what_they_say() {
    let expected = [
        (0x39, 599, [119, 7, 25], [3, 19, 29], 619_165, 301_676),
        (0x39, 599, [120, 6, 25], [12, 2, 9], 977_341, 2_339_721),
        (0x3B, 600, [117, 9, 6], [14, 31, 22], 818_090, 165_433),
    ];
    for ((model, head, tail), want) in REAL.into_iter().zip(expected) {
        let layout = model.layout();
        let mut packet = vec![0; layout.len + 4];
        packet[..head.len()].copy_from_slice(head);
        let tail = bytes(tail);
        let at = packet.len() - tail.len();
        packet[at..].copy_from_slice(&tail);
        let view = DataPacket::new(packet.as_slice()).unwrap();
        let clock = view.clock();
        let (mode, rpm) = (view.return_mode_code(), view.motor_rpm());
        let got = (
            mode,
            rpm,
            clock.date,
            clock.time,
            clock.micros,
            view.sequence().unwrap(),
        );
        assert_eq!(got, want, "{model}");
        assert_eq!(view.model(), model);
        // Both directions: our own packet with the same content has the same bytes, but for what is reserved.
        let mode = ReturnMode::from_code(mode).unwrap();
        let mut own = DataPacket::init(vec![0; packet.len()], model, mode).unwrap();
        own.set_motor_rpm(rpm);
        own.set_clock(&clock);
        own.set_sequence(want.5);
        let own = own.into_inner();
        let from = layout.motor_speed.min(layout.return_mode);
        let to = packet.len();
        assert_eq!(own[from..to], packet[from..to], "{model}");
        assert_eq!(own[..head.len()], *head, "{model}");
    }
}

#[test]
fn what_is_set_is_read_and_what_is_wrong_is_refused() {
    for model in Model::ALL {
        let layout = model.layout();
        let mut packet = DataPacket::init(vec![0; layout.len], model, ReturnMode::Last).unwrap();
        for block in 0..layout.blocks {
            packet.set_azimuth_centideg(block, 36_000 + block as u16);
            for channel in 0..layout.channels {
                packet.set_return(
                    block,
                    channel,
                    (block * 1000 + channel) as u16,
                    channel as u8,
                );
            }
        }
        let good = packet.into_inner();
        let view = DataPacket::new(good.as_slice()).unwrap();
        for block in 0..layout.blocks {
            assert_eq!(view.azimuth_centideg(block), block as u16);
            for channel in 0..layout.channels {
                assert_eq!(
                    view.distance_raw(block, channel),
                    (block * 1000 + channel) as u16
                );
                assert_eq!(view.reflectivity(block, channel), channel as u8);
            }
        }
        assert_eq!(view.sequence(), None);
        for cut in 0..good.len() {
            assert!(DataPacket::new(&good[..cut]).is_err());
        }
        let refused = |change: &dyn Fn(&mut Vec<u8>)| {
            let mut bad = good.clone();
            change(&mut bad);
            DataPacket::new(bad).is_err()
        };
        assert!(refused(&|b| b[0] = 0));
        assert!(refused(&|b| b[2] = 9));
        assert!(refused(&|b| b[layout.unit_at] = 2));
        assert!(refused(&|b| b[layout.block(1) + 1] = 0xFF));
        assert!(refused(&|b| b[layout.date + 4] = 60));
        assert!(refused(&|b| b[layout.timestamp + 3] = 1));
    }
}

#[test]
fn other_models_of_the_family_have_names() {
    let mut pandar40p = vec![0; 1262];
    pandar40p[..2].copy_from_slice(&[0xFF, 0xEE]);
    assert_eq!(unsupported(&pandar40p), Some("Pandar40P"));
    for (head, name) in [
        ([0xEE, 0xFF, 1, 3, 0, 0, 128, 2], "Pandar128 or OT128"),
        ([0xEE, 0xFF, 3, 2, 0, 0, 128, 2], "QT128"),
        ([0xEE, 0xFF, 4, 3, 0, 0, 128, 2], "AT128"),
        ([0xEE, 0xFF, 6, 1, 0, 0, 16, 8], "XT16"),
        ([0xEE, 0xFF, 6, 1, 0, 0, 32, 6], "XT32M"),
    ] {
        assert_eq!(unsupported(&head), Some(name));
    }
    for (_, head, _) in REAL {
        assert_eq!(unsupported(head), None);
    }
}
