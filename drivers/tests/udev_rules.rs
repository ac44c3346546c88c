//! The rules in `udev/` name the devices that the drivers know.

use std::fs;
use std::path::PathBuf;

use lsfb_drivers::{microstrain, mynt_d, mynt_s, xsens};

fn rules(name: &str) -> Vec<String> {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR"))
        .join("../udev")
        .join(name);
    let text = fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    text.lines()
        .filter(|line| !line.is_empty() && !line.starts_with('#'))
        .map(str::to_owned)
        .collect()
}

fn has_device(rule: &str, vendor: u16, product: Option<u16>) -> bool {
    let has = |key: &str, id: u16| {
        rule.contains(&format!("ATTR{{{key}}}==\"{id:04x}\""))
            || rule.contains(&format!("ATTRS{{{key}}}==\"{id:04x}\""))
    };
    has("idVendor", vendor) && product.is_none_or(|product| has("idProduct", product))
}

#[test]
fn every_camera_rule_is_about_the_units_the_driver_knows() {
    let rules = rules("70-lsfb-camera.rules");
    assert_eq!(rules.len(), 4);
    for rule in &rules {
        let (vendor, product) = (mynt_s::model::USB_VENDOR, mynt_s::model::USB_PRODUCT);
        assert!(has_device(rule, vendor, Some(product)), "{rule}");
    }
}

#[test]
fn every_imu_rule_is_about_the_units_the_driver_knows_or_their_converters() {
    let rules = rules("70-lsfb-imu.rules");
    let units = [
        (xsens::model::USB_VENDOR, None),
        (microstrain::model::USB_VENDOR, None),
        (mynt_d::model::USB_VENDOR, Some(mynt_d::model::USB_PRODUCT)),
    ];
    let drivers = ["ftdi_sio", "gs_usb"].map(|driver| format!("=\"{driver}\""));
    for rule in &rules {
        let of_unit = units
            .iter()
            .any(|&(vendor, product)| has_device(rule, vendor, product));
        let of_driver = drivers.iter().any(|driver| rule.contains(driver));
        assert!(of_unit || of_driver, "{rule}");
    }
    for (vendor, product) in units {
        let known = rules.iter().any(|rule| has_device(rule, vendor, product));
        assert!(known, "no rule for {vendor:04x}");
    }
    assert!(rules.iter().any(|rule| rule.contains("can_imu")));
}
