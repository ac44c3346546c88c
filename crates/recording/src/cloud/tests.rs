use super::*;

fn field(name: &str, kind: NumberKind, offset: usize) -> PackedField {
    PackedField {
        name: name.to_owned(),
        kind,
        offset,
    }
}

/// Points on a line with a field of times behind their coordinates.
fn with_times(name: &str, kind: NumberKind, times: &[&[u8]]) -> Result<Cloud, CloudError> {
    let mut data = Vec::new();
    for (k, time) in times.iter().enumerate() {
        data.extend(
            [k as f32 + 1.0, 2.0, 3.0]
                .iter()
                .flat_map(|c| c.to_le_bytes()),
        );
        data.extend(*time);
    }
    let point_bytes = 12 + kind.bytes();
    let cloud = PackedCloud {
        fields: vec![
            field("x", NumberKind::F32, 0),
            field("y", NumberKind::F32, 4),
            field("z", NumberKind::F32, 8),
            field(name, kind, 12),
        ],
        order: ByteOrder::Little,
        point_bytes,
        columns: times.len(),
        row_bytes: point_bytes * times.len(),
        rows: 1,
        data: &data,
    };
    cloud.unpack()
}

#[test]
fn times_of_every_driver_are_found() {
    let after = |nanos| TimesBegin::AfterStamp { nanos };
    let s = 1_700_000_000_u64;
    let at = |nanos: i64| {
        TimesBegin::At(lsfb_types::Timestamp::from_nanos(
            1_700_000_000_000_000_000 + nanos,
        ))
    };
    for (name, kind, first, last, begins) in [
        // Ouster, Velodyne (stamped at the last packet), Hesai, Livox, RoboSense.
        (
            "t",
            NumberKind::U32,
            2_000_000_u32.to_le_bytes().to_vec(),
            92_000_000_u32.to_le_bytes().to_vec(),
            after(2_000_000),
        ),
        (
            "time",
            NumberKind::F32,
            (-0.09_f32).to_le_bytes().to_vec(),
            0.0_f32.to_le_bytes().to_vec(),
            after(-90_000_000),
        ),
        (
            "timestamp",
            NumberKind::F64,
            (s as f64).to_le_bytes().to_vec(),
            (s as f64 + 0.09).to_le_bytes().to_vec(),
            at(0),
        ),
        (
            "offset_time",
            NumberKind::U32,
            0_u32.to_le_bytes().to_vec(),
            90_000_000_u32.to_le_bytes().to_vec(),
            after(0),
        ),
        (
            "timeOffset",
            NumberKind::F32,
            0_f32.to_le_bytes().to_vec(),
            9e7_f32.to_le_bytes().to_vec(),
            after(0),
        ),
        (
            "time_stamp",
            NumberKind::F64,
            (s as f64 * 1e9).to_le_bytes().to_vec(),
            (s as f64 * 1e9 + 9e7).to_le_bytes().to_vec(),
            at(0),
        ),
        (
            "timestamp",
            NumberKind::U64,
            (s * 1_000_000).to_le_bytes().to_vec(),
            (s * 1_000_000 + 90_000).to_le_bytes().to_vec(),
            at(0),
        ),
    ] {
        let cloud = with_times(name, kind, &[&last, &first]).expect(name);
        let PointTimes::Field {
            name: found,
            begins: found_begins,
        } = &cloud.times
        else {
            panic!("{name} {kind:?}: {:?}", cloud.times)
        };
        assert_eq!(found, name);
        let nanos = |b: &TimesBegin| match b {
            TimesBegin::AfterStamp { nanos } => *nanos,
            TimesBegin::At(time) => time.nanos(),
        };
        assert!(
            nanos(found_begins).abs_diff(nanos(&begins)) < 1_000,
            "{name}: {found_begins:?}"
        );
        let offsets: Vec<u32> = cloud.scan.points.iter().map(|p| p.time_offset_ns).collect();
        assert!(
            offsets[1] == 0 && offsets[0].abs_diff(90_000_000) < 300,
            "{name} {kind:?}: {offsets:?}"
        );
    }
}

/// Of two fields of times the one that holds some is used.
#[test]
fn an_empty_field_of_times_gives_way_to_one_that_holds_some() {
    let mut data = Vec::new();
    for time in [0.0_f32, 0.1] {
        data.extend(
            [1.0, 2.0, 3.0, 0.0, time]
                .iter()
                .flat_map(|c: &f32| c.to_le_bytes()),
        );
    }
    let names = ["x", "y", "z", "timestamp", "time"];
    let cloud = PackedCloud {
        fields: (0..5)
            .map(|i| field(names[i], NumberKind::F32, 4 * i))
            .collect(),
        order: ByteOrder::Little,
        point_bytes: 20,
        columns: 2,
        row_bytes: 40,
        rows: 1,
        data: &data,
    };
    let found = cloud.unpack().expect("a cloud");
    assert!(matches!(&found.times, PointTimes::Field { name, .. } if name == "time"));
    assert_eq!(found.scan.points[1].time_offset_ns, 100_000_001);
}

#[test]
fn what_does_not_fit_is_refused_by_name() {
    let good = PackedCloud {
        fields: ["x", "y", "z"]
            .iter()
            .zip(0..)
            .map(|(n, i)| field(n, NumberKind::F32, 4 * i))
            .collect(),
        order: ByteOrder::Big,
        point_bytes: 12,
        columns: 1,
        row_bytes: 12,
        rows: 1,
        data: &[0; 12],
    };
    assert_eq!(good.unpack().expect("one point").scan.points.len(), 1);
    let far: Vec<u8> = [4.5e5_f32, 5.4e6, 30.0]
        .iter()
        .flat_map(|c| c.to_be_bytes())
        .collect();
    let with = |change: &dyn Fn(&mut PackedCloud<'_>)| {
        let mut cloud = good.clone();
        change(&mut cloud);
        cloud.unpack()
    };
    for (result, words) in [
        (with(&|c| c.point_bytes = 8), "field z ends at byte 12"),
        (with(&|c| c.row_bytes = 11), "cannot hold 1 points"),
        (with(&|c| c.columns = 2), "cannot hold 2 points"),
        (with(&|c| c.rows = 2), "12 bytes of points, but 24"),
        (with(&|c| c.rows = usize::MAX), "a scan has at most"),
        (with(&|c| c.fields.truncate(1)), "available: x"),
    ] {
        let error = result.expect_err(words).to_string();
        assert!(error.contains(words), "{error}");
    }
    let map = PackedCloud {
        data: &far,
        ..good.clone()
    };
    let error = map.unpack().expect_err("a map").to_string();
    assert!(error.contains("km from the origin"), "{error}");
}
