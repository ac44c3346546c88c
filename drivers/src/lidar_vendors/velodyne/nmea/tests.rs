use super::*;

#[test]
fn sentences_of_both_ages_are_read() {
    let old = Rmc::parse(b"$GPRMC,123519,A,4807.038,N,01131.000,E,022.4,084.4,230394,003.1,W*6A")
        .unwrap();
    let expected = Rmc {
        hour: 12,
        minute: 35,
        second: 19,
        millis: 0,
        valid: true,
        latitude_e5_min: Some((48 * 60 + 7) * 100_000 + 3_800),
        longitude_e5_min: Some((11 * 60 + 31) * 100_000),
        speed_e3_knots: Some(22_400),
        course_e3_deg: Some(84_400),
        day: 23,
        month: 3,
        year: 2094,
        mode: None,
    };
    assert_eq!(old, expected);
    let new = Rmc::parse(b"$GPRMC,123519,A,4807.038,N,01131.000,E,022.4,084.4,230394,003.1,W,A*07")
        .unwrap();
    assert_eq!(
        new,
        Rmc {
            mode: Some('A'),
            ..expected
        }
    );
    let absent =
        Rmc::parse(b"$GPRMC,235959,V,4807.038,N,01131.000,E,000.0,000.0,311224,,,N*6C").unwrap();
    assert_eq!((absent.valid, absent.speed_e3_knots), (false, Some(0)));
    assert_eq!((absent.year, absent.mode), (2024, Some('N')));
    // 2024-12-31T23:59:59Z
    assert_eq!(absent.unix_secs(), 1_735_689_599);
}

#[test]
fn what_is_written_is_read_back() {
    let rmc = Rmc {
        hour: 10,
        minute: 0,
        second: 7,
        millis: 250,
        valid: true,
        latitude_e5_min: Some(-291_234_567),
        longitude_e5_min: Some(-1_079_999_999),
        speed_e3_knots: Some(1_234),
        course_e3_deg: Some(359_999),
        day: 1,
        month: 3,
        year: 2026,
        mode: Some('D'),
    };
    assert_eq!(Rmc::parse(rmc.emit().as_bytes()), Ok(rmc));
    // 2026-03-01T10:00:07Z
    assert_eq!(rmc.unix_secs(), 1_772_359_207);
    let bare = Rmc {
        day: 29,
        month: 2,
        year: 2000,
        ..Rmc::default()
    };
    assert_eq!(Rmc::parse(bare.emit().as_bytes()), Ok(bare));
    assert_eq!(bare.unix_secs(), 951_782_400);
}

#[test]
fn damaged_sentences_are_errors() {
    let good = b"$GPRMC,123519,A,4807.038,N,01131.000,E,022.4,084.4,230394,003.1,W*6A";
    for at in 1..good.len() - 3 {
        let mut bad = *good;
        bad[at] ^= 0x01;
        assert!(Rmc::parse(&bad).is_err(), "{at}");
        let _ = Rmc::parse(&good[..at]);
    }
    for text in [
        "",
        "*",
        "$*00",
        "$GPGGA*56",
        "$GPGLL*50",
        "$GPRMC*4B",
        "$GPRMC,,,,,,,,,*67",
        "$GPRMC,é*00",
    ] {
        assert!(Rmc::parse(text.as_bytes()).is_err(), "{text}");
    }
}

/// The sentence that receivers' manuals print.
const GGA: &[u8] = b"$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,*47";

#[test]
fn fix_data_is_read_and_written_back() {
    let read = Gga::parse(GGA).unwrap();
    let expected = Gga {
        hour: 12,
        minute: 35,
        second: 19,
        millis: 0,
        latitude_e5_min: Some((48 * 60 + 7) * 100_000 + 3_800),
        longitude_e5_min: Some((11 * 60 + 31) * 100_000),
        quality: 1,
        satellites: Some(8),
        hdop_e2: Some(90),
        altitude_mm: Some(545_400),
        geoid_mm: Some(46_900),
    };
    assert_eq!(read, expected);
    let below = Gga {
        millis: 250,
        latitude_e5_min: Some(-291_234_567),
        longitude_e5_min: None,
        quality: 5,
        satellites: None,
        hdop_e2: None,
        altitude_mm: Some(-3_070),
        geoid_mm: None,
        ..expected
    };
    for gga in [expected, below, Gga::default()] {
        assert_eq!(Gga::parse(gga.emit().as_bytes()), Ok(gga), "{}", gga.emit());
    }
    for at in 1..GGA.len() - 3 {
        let mut bad = GGA.to_vec();
        bad[at] ^= 0x01;
        assert!(Gga::parse(&bad).is_err(), "{at}");
        let _ = Gga::parse(&GGA[..at]);
    }
}

#[test]
fn either_sentence_names_the_second() {
    let rmc = b"$GPRMC,123519,A,4807.038,N,01131.000,E,022.4,084.4,230394,003.1,W*6A";
    let Ok(Sentence::Rmc(dated)) = Sentence::parse(rmc) else {
        panic!("a dated sentence");
    };
    let noon_secs = dated.unix_secs();
    let undated = Sentence::parse(GGA).unwrap();
    // The host's clock is up to half a day off, across midnight too.
    for off_secs in [-43_000, -3_600, 0, 7, 43_000] {
        assert_eq!(undated.unix_secs(noon_secs + off_secs), Some(noon_secs));
    }
    let late = Gga {
        hour: 23,
        minute: 59,
        second: 59,
        ..Gga::default()
    };
    let midnight_secs = noon_secs.div_euclid(86_400) * 86_400;
    assert_eq!(late.unix_secs(midnight_secs + 2), midnight_secs - 1);
    // Without a fix there is nothing to go by.
    assert_eq!(Sentence::Gga(late).unix_secs(midnight_secs), None);
    let mixed = String::from_utf8(GGA.to_vec()).unwrap();
    let mixed = mixed.replace("$GP", "$GN").replace("*47", "*59");
    assert_eq!(Sentence::parse(mixed.as_bytes()), Ok(undated));
}
