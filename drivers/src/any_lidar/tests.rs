use super::*;
use crate::lidar::SensorSettings;
use crate::lidar_vendors::hesai::wire::{Clock, DataPacket};
use crate::lidar_vendors::{hesai, velodyne};

/// One XT32 packet, `number` half milliseconds after the top of the hour.
fn xt32(number: u32) -> Packet {
    let layout = hesai::Model::Xt32.layout();
    let bytes = vec![0; layout.len + 4];
    let mode = hesai::wire::ReturnMode::Strongest;
    let mut packet = DataPacket::init(bytes, hesai::Model::Xt32, mode).unwrap();
    let micros = number * 400;
    for block in 0..layout.blocks {
        packet.set_azimuth_centideg(block, (number as usize * 144 + block * 18) as u16);
        packet.set_return(block, 0, 1000, 20);
    }
    packet.set_clock(&Clock {
        date: [126, 3, 1],
        time: [10, 0, 0],
        micros,
    });
    packet.set_sequence(number);
    Packet {
        arrival: Timestamp::from_nanos(i64::from(micros) * 1_000),
        bytes: packet.into_inner(),
    }
}

#[test]
fn the_first_data_packet_decides_whose_they_are() {
    let mut decoder = Decoder::new(Settings::default());
    let strange = Packet {
        arrival: Timestamp::default(),
        bytes: vec![0xA5, 0xFF, 0x00, 0x5A, 0, 0],
    };
    let error = decoder.push(&strange).unwrap_err();
    assert!(
        error.to_string().contains("looks like RoboSense"),
        "{error}"
    );
    for number in 0..10 {
        decoder.push(&xt32(number)).unwrap();
    }
    let found = decoder.found().unwrap();
    assert_eq!(found.model, Model::Hesai(hesai::Model::Xt32));
    assert_eq!(
        (found.returns, decoder.counters().packets),
        ("strongest", 10)
    );
    assert!(!decoder.is_data(&[0; 1206]), "a Velodyne's");
    assert_eq!(decoder.finish().unwrap().sample.points.len(), 80);
}

#[test]
fn a_configured_model_keeps_others_out() {
    for model in Model::all() {
        let settings = Settings {
            model: Some(model),
            ..Settings::default()
        };
        let mut decoder = Decoder::new(settings);
        let result = decoder.push(&xt32(0));
        assert_eq!(
            result.is_ok(),
            model == Model::Hesai(hesai::Model::Xt32),
            "{model}"
        );
    }
}

/// A vendor whose packets another one takes for its own, or whose own decoder refuses them, cannot be recorded.
#[test]
fn packets_of_each_model_are_taken_by_its_own_decoder() {
    let blank = blank_packets();
    for model in Model::all() {
        let own = blank.iter().filter(|(of, _)| *of == model);
        let mut count = 0;
        for (_, bytes) in own {
            count += 1;
            let mut decoder = Decoder::new(Settings::default());
            let packet = |ms: i64| Packet {
                arrival: Timestamp::from_nanos(ms * 1_000_000),
                bytes: bytes.clone(),
            };
            assert!(decoder.is_data(bytes) && !is_beside_data(bytes), "{model}");
            decoder.push(&packet(0)).unwrap();
            assert_eq!(decoder.found().unwrap().model, model);
        }
        assert!(count >= 3, "{model} has {count} ways of sending echoes");
    }
}

#[test]
fn models_are_found_by_the_names_that_people_write() {
    for model in Model::all() {
        assert_eq!(Model::from_key(&model.key()), Some(model));
    }
    let vlp32c = Some(Model::Velodyne(velodyne::Model::Vlp32c));
    for name in ["vlp32c", "VLP-32C", "vlp-32c"] {
        assert_eq!(Model::from_key(name), vlp32c);
    }
    assert_eq!(Model::from_key("os1-64"), None);
}

#[test]
fn packets_that_overtook_each_other_are_put_back_and_a_set_clock_is_not_sorted() {
    let order = [
        0, 1, 3, 2, 4, 9, 5, 6, 7, 8, 10, 11, 12, 13, 14, 15, 16, 17, 18,
    ];
    let mut reorder = Reorder::default();
    let mut out: Vec<Packet> = order
        .into_iter()
        .flat_map(|n| reorder.push(xt32(n)))
        .collect();
    out.extend(reorder.finish());
    let expected: Vec<Packet> = (0..19).map(xt32).collect();
    assert_eq!(out, expected);
    assert_eq!(reorder.moved(), 5);
    // Half a second back: what was held goes first.
    let mut out: Vec<Packet> = [2_000, 2_001, 0, 1]
        .into_iter()
        .flat_map(|n| reorder.push(xt32(n)))
        .collect();
    out.extend(reorder.finish());
    assert_eq!(out, [2_000, 2_001, 0, 1].map(xt32));
}

/// The pages of Velodyne sensors were asked for by whoever recorded, whatever the sensor was said to be.
#[test]
fn sensors_are_set_by_the_page_of_their_vendor() {
    let settings = SensorSettings {
        rpm: Some(601),
        ..SensorSettings::default()
    };
    for model in [None, Some(Model::Velodyne(velodyne::Model::Vlp16))] {
        let page = page_of(model).unwrap();
        let refused = (page.check)(&settings).unwrap_err();
        assert_eq!(refused.to_string(), "rpm cannot be `601`");
    }
    assert!(page_of(Some(Model::Hesai(hesai::Model::Xt32))).is_none());
}

#[test]
fn ports_are_those_of_the_first_unless_told_otherwise() {
    assert_eq!(DEFAULT_PORTS, [2368, 8308]);
    assert_eq!(factory_ports(), [2368, 8308, 10110]);
}
