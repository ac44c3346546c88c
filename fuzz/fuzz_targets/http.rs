//! Answers and requests of a sensor's web page, and its documents.
#![no_main]

use libfuzzer_sys::fuzz_target;
use lsfb_drivers::transport::http::{HttpRequest, HttpResponse, Stream};
use lsfb_drivers::velodyne::settings::{SensorInfo, SensorStatus, Settings};

fuzz_target!(|data: &[u8]| {
    let open = HttpResponse::parse(data, Stream::Open);
    let closed = HttpResponse::parse(data, Stream::Closed);
    if let Ok(Some(response)) = &open {
        // What is whole stays so when more comes.
        assert_eq!(closed.as_ref(), Ok(&Some(response.clone())));
    }
    if let Ok(Some(response)) = closed
        && !matches!(response.status, 100..200 | 204 | 304)
    {
        let again = HttpResponse::parse(&response.emit(), Stream::Open);
        assert_eq!(again, Ok(Some(response)));
    }
    if let Ok(Some(request)) = HttpRequest::parse(data)
        && !request.path.contains(['\r', '\n'])
        && request.method == lsfb_drivers::transport::http::Method::Post
    {
        assert_eq!(HttpRequest::parse(&request.emit("h")), Ok(Some(request)));
    }
    if let Ok(settings) = Settings::parse(data) {
        assert_eq!(Settings::parse(settings.emit().as_bytes()), Ok(settings));
    }
    let _ = SensorInfo::parse(data);
    let _ = SensorStatus::parse(data);
    if let Some((path, body)) = std::str::from_utf8(data)
        .ok()
        .and_then(|t| t.split_once(' '))
    {
        let mut settings = Settings::default();
        let _ = settings.apply(path, body);
        assert_eq!(Settings::parse(settings.emit().as_bytes()), Ok(settings));
    }
});
