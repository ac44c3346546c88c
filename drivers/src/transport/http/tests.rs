use std::time::Duration;

use super::*;
use crate::Error;
use crate::test_random::Random;

fn whole(text: &[u8]) -> HttpResponse {
    HttpResponse::parse(text, Stream::Open).unwrap().unwrap()
}

#[test]
fn answers_of_every_framing_are_read() {
    let by_length = b"HTTP/1.0 200 OK\r\ncontent-length: 3\r\n\r\nabcdef";
    assert_eq!(whole(by_length).body, b"abc");
    let chunked = b"HTTP/1.1 200 OK\r\nTransfer-Encoding: Chunked\r\n\r\n3;x=y\r\nabc\r\nA\r\n0123456789\r\n0\r\n\r\n";
    assert_eq!(whole(chunked).body, b"abc0123456789");
    let empty = b"HTTP/1.1 204 No Content\r\nServer: x\r\n\r\n";
    assert_eq!((whole(empty).status, whole(empty).body.len()), (204, 0));
    let by_close = b"HTTP/1.1 404 Not Found\r\n\r\nnothing here";
    assert_eq!(HttpResponse::parse(by_close, Stream::Open), Ok(None));
    let closed = HttpResponse::parse(by_close, Stream::Closed)
        .unwrap()
        .unwrap();
    assert_eq!(
        (closed.status, &closed.body[..]),
        (404, &b"nothing here"[..])
    );
    for text in [&by_length[..], chunked, empty] {
        for end in 0..text.len() - 10 {
            let part = HttpResponse::parse(&text[..end], Stream::Open);
            assert!(matches!(part, Ok(None | Some(_))), "{end}: {part:?}");
        }
    }
    assert!(HttpResponse::parse(&by_length[..40], Stream::Closed).is_err());
    let response = HttpResponse {
        status: 200,
        body: b"{}".to_vec(),
    };
    assert_eq!(whole(&response.emit()), response);
}

#[test]
fn requests_are_written_and_read() {
    for request in [
        HttpRequest {
            method: Method::Get,
            path: "/cgi/settings.json".to_owned(),
            body: Vec::new(),
        },
        HttpRequest {
            method: Method::Post,
            path: "/cgi/setting".to_owned(),
            body: b"rpm=600".to_vec(),
        },
    ] {
        let bytes = request.emit("192.168.1.201");
        assert_eq!(HttpRequest::parse(&bytes), Ok(Some(request)));
        assert_eq!(HttpRequest::parse(&bytes[..bytes.len() - 1]), Ok(None));
    }
    for text in [
        "PUT / HTTP/1.1\r\n\r\n",
        "GET x HTTP/1.1\r\n\r\n",
        "GET\r\n\r\n",
    ] {
        assert!(HttpRequest::parse(text.as_bytes()).is_err(), "{text}");
    }
}

#[test]
fn sizes_are_bounded_and_nonsense_is_an_error() {
    for text in [
        "HTTP/1.1 999 X\r\n\r\n",
        "HTTP/2 200 OK\r\n\r\n",
        "ICY 200 OK\r\n\r\n",
        "HTTP/1.1 200 OK\r\nContent-Length: 99999999999\r\n\r\n",
        "HTTP/1.1 200 OK\r\nContent-Length: -1\r\n\r\n",
        "HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\nFFFFFFFFFFFFFFFF\r\n",
        "HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n1\r\nabc\r\n",
    ] {
        let outcome = HttpResponse::parse(text.as_bytes(), Stream::Open);
        assert!(outcome.is_err(), "{text}: {outcome:?}");
    }
    let endless = vec![b'x'; MAX_HEAD_LEN];
    let unfinished = [b"HTTP/1.1 200 OK\r\nServer: ", &endless[..]].concat();
    for head in [endless, unfinished] {
        assert!(HttpResponse::parse(&head, Stream::Open).is_err());
    }
    // What belongs in no head does not keep a sensor's answer from being read.
    let odd = b"HTTP/1.1 200 OK\r\nno field\r\nServer : x\r\nContent-Length : 1\r\n\r\ny";
    assert_eq!(whole(odd).body, b"y");
    let mut random = Random::new(4);
    for _ in 0..20_000 {
        let mut bytes = b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\nContent-Length: 2\r\n\r\n3\r\nabc\r\n0\r\n\r\n".to_vec();
        random.mutate(&mut bytes);
        let _ = HttpResponse::parse(&bytes, Stream::Open);
        let _ = HttpResponse::parse(&bytes, Stream::Closed);
        let _ = HttpRequest::parse(&bytes);
    }
}

#[test]
fn a_server_that_is_absent_silent_or_hangs_up_is_an_error() {
    let listener = HttpListener::bind(([127, 0, 0, 1], 0).into()).unwrap();
    let address = listener.address();
    let request = HttpRequest {
        method: Method::Get,
        path: "/".to_owned(),
        body: Vec::new(),
    };
    let silent = exchange(address, &request, Duration::from_millis(50));
    assert!(matches!(silent, Err(Error::Lost { .. })), "{silent:?}");
    let hang_up = std::thread::Builder::new()
        .name("hang-up".to_owned())
        .spawn(move || {
            listener
                .listener
                .accept()
                .map(drop)
                .and(listener.listener.accept())
                .map(drop)
        })
        .unwrap();
    let cut = exchange(address, &request, Duration::from_secs(5)).unwrap_err();
    assert!(
        matches!(
            cut,
            Error::Protocol { .. } | Error::Lost { .. } | Error::Send { .. }
        ),
        "{cut}"
    );
    hang_up.join().unwrap().unwrap();
    let absent = exchange(address, &request, Duration::from_secs(1)).unwrap_err();
    assert!(matches!(absent, Error::Open { .. }), "{absent}");
}
