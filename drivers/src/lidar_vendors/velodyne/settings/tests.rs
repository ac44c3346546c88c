use super::*;
use crate::test_random::Random;

fn all() -> [Setting; 6] {
    [
        Setting::Laser(Switch::Off),
        Setting::Returns(Returns::Dual),
        Setting::Rpm(1200),
        Setting::FieldOfView(FieldOfView {
            start_deg: 270,
            end_deg: 90,
        }),
        Setting::PhaseLock(PhaseLock {
            lock: Switch::On,
            offset_centideg: 9_050,
        }),
        Setting::Destination(Destination {
            address: Ipv4Addr::new(192, 168, 1, 77),
            data_port: 2369,
            position_port: 8309,
        }),
    ]
}

#[test]
fn forms_have_the_documented_bytes() {
    let forms = all().map(|setting| setting.emit().unwrap());
    let expected = [
        ("/cgi/setting", "laser=off"),
        ("/cgi/setting", "returns=Dual"),
        ("/cgi/setting", "rpm=1200"),
        ("/cgi/setting/fov", "start=270&end=90"),
        ("/cgi/setting/phaselock", "enabled=on&offset=9050"),
        (
            "/cgi/setting/host",
            "addr=192.168.1.77&dport=2369&tport=8309",
        ),
    ];
    for (form, (path, body)) in forms.iter().zip(expected) {
        assert_eq!((form.path, form.body.as_str()), (path, body));
    }
}

#[test]
fn what_is_set_is_read_back() {
    let mut settings = Settings::default();
    for setting in all() {
        let form = setting.emit().unwrap();
        assert_ne!(setting.of(&settings), setting);
        settings.apply(form.path, &form.body).unwrap();
        assert_eq!(setting.of(&settings), setting);
    }
    assert_eq!(Settings::parse(settings.emit().as_bytes()), Ok(settings));
}

#[test]
fn a_document_of_a_real_unit_is_read() {
    // Names and spelling as quoted from a VLP-16's own answers; numbers may be text.
    let document = br#"{"returns":"Strongest","rpm":"600","laser":"On","fov":{"start":"0","end":359},
        "phaselock":{"enabled":"Off","offset":0},"host":{"addr":"255.255.255.255","dport":2368,"tport":8308},
        "net":{"addr":"192.168.1.201","dhcp":"Off","gateway":"192.168.1.1","mask":"255.255.255.0"}}"#;
    assert_eq!(Settings::parse(document), Ok(Settings::default()));
    let status = br#"{"gps":{"pps_state":"Absent","position":"49 00.00N 200 .00W"},
        "motor":{"state":"On","rpm":599,"lock":"Off","phase":22222},"laser":{"state":"On"}}"#;
    let expected = SensorStatus {
        pps: PpsStatus::Absent,
        motor: Switch::On,
        motor_rpm: 599,
        laser: Switch::On,
    };
    assert_eq!(SensorStatus::parse(status), Ok(expected));
    assert_eq!(
        SensorStatus::parse(expected.emit().as_bytes()),
        Ok(expected)
    );
}

#[test]
fn values_that_the_sensor_does_not_have_are_refused_whole() {
    for setting in [
        Setting::Rpm(299),
        Setting::Rpm(310),
        Setting::Rpm(1260),
        Setting::FieldOfView(FieldOfView {
            start_deg: 0,
            end_deg: 360,
        }),
        Setting::PhaseLock(PhaseLock {
            lock: Switch::On,
            offset_centideg: 36_000,
        }),
    ] {
        assert!(setting.emit().is_err(), "{setting:?}");
    }
    let mut settings = Settings::default();
    for (path, body) in [
        ("/cgi/setting", "rpm=600&returns=Both"),
        ("/cgi/setting", "rpm=1200&x=1"),
        ("/cgi/setting/fov", "start=10&end=400"),
        ("/cgi/setting/host", "addr=1.2.3"),
        ("/cgi/nowhere", "rpm=900"),
        ("/cgi/setting", ""),
    ] {
        assert!(settings.apply(path, body).is_err(), "{path} {body}");
    }
    assert_eq!(settings, Settings::default());
}

#[test]
fn mutated_documents_never_panic() {
    let mut random = Random::new(9);
    for _ in 0..5_000 {
        let mut document = Settings::default().emit().into_bytes();
        random.mutate(&mut document);
        let _ = Settings::parse(&document);
        let _ = SensorInfo::parse(&document);
        let _ = SensorStatus::parse(&document);
    }
}
