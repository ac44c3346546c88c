use super::*;

#[test]
fn data_packet_is_read_and_written_byte_by_byte() {
    let bytes = include_bytes!("../../../../tests/vectors/vlp32c_strongest_wrap.bin");
    assert_eq!(
        bytes[..10],
        [0xFF, 0xEE, 0x3C, 0x8C, 0xF4, 0x01, 0x00, 0xEE, 0x02, 0x07]
    );
    assert_eq!(bytes[1200..], [0xD4, 0xA2, 0x93, 0xD6, 0x37, 0x28]);
    let packet = DataPacket::new(&bytes[..]).unwrap();
    assert_eq!(packet.timestamp_us(), 3_599_999_700);
    assert_eq!(
        returns_of_code(packet.return_mode_code()),
        Some(Returns::Strongest)
    );
    assert_eq!(Product::from_code(packet.product_code()), Product::Vlp32c);
    assert_eq!(identify(bytes), Ok(Product::Vlp32c));
    let azimuths: Vec<u16> = (0..BLOCKS).map(|b| packet.azimuth_centideg(b)).collect();
    assert_eq!(
        azimuths,
        [
            35900, 35920, 35940, 35960, 35980, 0, 19, 39, 59, 79, 99, 119
        ]
    );

    let mut written =
        DataPacket::init([0xAA; DATA_PACKET_LEN], Product::Vlp32c, Returns::Strongest).unwrap();
    for block in 0..BLOCKS {
        written.set_azimuth_centideg(block, packet.azimuth_centideg(block));
        for channel in 0..CHANNELS {
            let (distance, reflectivity) = (
                packet.distance_raw(block, channel),
                packet.reflectivity(block, channel),
            );
            written.set_return(block, channel, distance, reflectivity);
        }
    }
    written.set_timestamp_us(packet.timestamp_us());
    assert_eq!(written.into_inner(), *bytes);
}

#[test]
fn what_is_no_data_packet_says_why() {
    let mut bytes = *include_bytes!("../../../../tests/vectors/vlp32c_dual.bin");
    let short = DataPacket::new(&bytes[..512]).unwrap_err();
    assert_eq!(
        short,
        WireError::Length {
            expected: 1206,
            got: 512
        }
    );
    assert_eq!(
        identify(&[]),
        Err(WireError::Length {
            expected: 1206,
            got: 0
        })
    );
    bytes[302..304].copy_from_slice(&36_000u16.to_le_bytes());
    let azimuth = DataPacket::new(&bytes[..]).unwrap_err();
    assert_eq!(
        azimuth,
        WireError::Value {
            field: "azimuth",
            offset: 302,
            got: 36_000
        }
    );
    bytes[201] = 0xDD;
    let flag = DataPacket::new(&bytes[..]).unwrap_err();
    assert_eq!(
        flag,
        WireError::Constant {
            offset: 200,
            expected: 0xEEFF,
            got: 0xDDFF
        }
    );
    assert_eq!(identify(&bytes), Ok(Product::Hdl64e));
}

#[test]
fn position_packet_with_lock_is_read_and_written_byte_by_byte() {
    let bytes = include_bytes!("../../../../tests/vectors/velodyne_position_locked.bin");
    let packet = PositionPacket::new(&bytes[..]).unwrap();
    assert_eq!(packet.top_temperature_celsius(), 45);
    assert_eq!(packet.bottom_temperature_celsius(), 40);
    assert_eq!(packet.calibration_temperature_celsius(), 38);
    assert_eq!(packet.calibration_change_celsius(), -3);
    assert_eq!(packet.calibration_age_secs(), 600);
    assert_eq!(packet.calibration_reason(), 3);
    assert_eq!(packet.calibration_flags(), 0b010);
    assert_eq!(packet.timestamp_us(), 2_119_000_123);
    assert_eq!(packet.pps_status(), PpsStatus::Locked);
    assert_eq!(packet.thermal_status(), 0);
    assert_eq!(packet.shutdown_temperature_celsius(), 0);
    assert_eq!(packet.power_up_temperature_celsius(), 25);
    let sentence = b"$GPRMC,123519.00,A,4807.038,N,01131.000,E,022.4,084.4,230324,003.1,W*4F";
    assert_eq!(packet.nmea(), sentence);

    let mut written = PositionPacket::init([0xAA; POSITION_PACKET_LEN]).unwrap();
    written.set_temperatures_celsius(45, 40, 25);
    written.set_calibration(&Calibration {
        temperature_celsius: 38,
        change_celsius: -3,
        age_secs: 600,
        reason: 3,
        flags: 0b010,
    });
    written.set_thermal(0, 0);
    written.set_timestamp_us(2_119_000_123);
    written.set_pps_status(PpsStatus::Locked);
    written.set_nmea(sentence).unwrap();
    assert_eq!(written.into_inner(), *bytes);
}

#[test]
fn position_packet_without_pulse() {
    let bytes = include_bytes!("../../../../tests/vectors/velodyne_position_absent.bin");
    let packet = PositionPacket::new(&bytes[..]).unwrap();
    assert_eq!(
        (packet.pps_status(), packet.timestamp_us()),
        (PpsStatus::Absent, 3_599_500_000)
    );
    assert_eq!(
        packet.nmea(),
        b"$GPRMC,235959,V,4807.038,N,01131.000,E,000.0,000.0,311224,,,N*6C"
    );
    assert_eq!(PpsStatus::from_code(9).code(), 9);
    let mut packet = PositionPacket::init([0; POSITION_PACKET_LEN]).unwrap();
    assert_eq!(packet.nmea(), b"");
    assert_eq!(
        packet.set_nmea(&[b'x'; 127]),
        Err(WireError::Length {
            expected: 126,
            got: 127
        })
    );
    assert_eq!(packet.set_nmea(&[b'x'; 126]), Ok(()));
    assert_eq!(packet.nmea().len(), 126);
    assert!(PositionPacket::new(&[0; 511][..]).is_err());
}
