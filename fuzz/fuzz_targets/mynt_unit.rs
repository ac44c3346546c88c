//! Device information and calibration, options, and the unit's side of the extension unit.
#![no_main]

use libfuzzer_sys::fuzz_target;
use lsfb_drivers::mynt_s::wire::{CameraOption, DeviceInfo, ImageCalibration, ImuCalibration, ImuProtocol, OptionCommand, UnitFile, XuDevice};
use lsfb_drivers::transport::uvc::{XuQuery, XuSelector};

fuzz_target!(|data: &[u8]| {
    // As it is, and with the length and checksum that an answer needs.
    let mut answer = vec![1];
    answer.extend((data.len() as u16).to_be_bytes());
    answer.extend(data);
    answer.push(data.iter().fold(0, |sum, byte| sum ^ byte));
    for bytes in [data, &answer[..]] {
        if let Ok(info) = DeviceInfo::parse(bytes)
            && info.name.is_ascii()
            && info.serial.is_ascii()
        {
            assert_eq!(DeviceInfo::parse(&info.emit()), Ok(info));
        }
    }
    for file in UnitFile::ALL {
        let _ = file.find(data);
    }
    if let Ok(calibration) = ImageCalibration::parse(data) {
        assert_eq!(calibration.emit().as_deref(), Ok(data));
    }
    if let Ok(calibration) = ImuCalibration::parse(data) {
        assert_eq!(calibration.emit(), data);
    }
    if let Ok(command) = OptionCommand::parse(data) {
        assert_eq!(OptionCommand::parse(&command.emit()), Ok(command));
    }
    let _ = OptionCommand::parse_value(CameraOption::MaxGain, data);
    let mut device = XuDevice::new(DeviceInfo::default(), ImuProtocol::Integer);
    for request in data.chunks(6) {
        let Some(selector) = request.first().and_then(|id| XuSelector::from_id(id % 6)) else {
            continue;
        };
        let mut bytes = request.to_vec();
        bytes.resize(selector.len_bytes(), 0);
        let _ = device.set(selector, &bytes);
        for query in [XuQuery::GetCur, XuQuery::GetMax] {
            if let Ok(answer) = device.get(selector, query) {
                assert_eq!(answer.len(), selector.len_bytes());
            }
        }
    }
});
