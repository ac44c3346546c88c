//! Under which names the server is asked.
//!
//! A page of somebody else can have its own name lead to this machine (DNS rebinding): its scripts would then be of the same
//! site as the operator's page and could start and stop recordings. They cannot choose the `Host` that a browser sends. So what
//! is asked under a name that nobody gave this server is refused. Addresses are safe: a page that was loaded from one of ours is
//! ours.

use std::net::IpAddr;

use hyper::Request;
use hyper::body::Incoming;
use hyper::header::{HOST, ORIGIN};

/// Where the kernel tells the machine's name.
const HOST_NAME: &str = "/proc/sys/kernel/hostname";
/// What multicast DNS adds to it.
const LOCAL_DOMAIN: &str = ".local";

/// The names that are ours.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Names(Vec<String>);

impl Names {
    /// This machine's own names, and those it was `given`.
    pub fn new(given: &[String]) -> Self {
        let own = std::fs::read_to_string(HOST_NAME).unwrap_or_default();
        Self::of(own.trim(), given)
    }

    fn of(own: &str, given: &[String]) -> Self {
        let mut names = vec!["localhost".to_owned()];
        if !own.is_empty() {
            names.extend([own.to_owned(), format!("{own}{LOCAL_DOMAIN}")]);
        }
        names.extend(given.iter().cloned());
        Self(names)
    }

    /// Whether a request asks for one of them.
    pub fn are_asked(&self, request: &Request<Incoming>) -> bool {
        let host = request.headers().get(HOST);
        host.and_then(|host| host.to_str().ok())
            .is_some_and(|host| self.include(host))
    }

    /// Whether a request's `Host` (a name or an address, with or without a port) is one of ours.
    pub fn include(&self, host: &str) -> bool {
        let name = without_port(host);
        let address = name.trim_start_matches('[').trim_end_matches(']');
        let is_address = address.parse::<IpAddr>().is_ok();
        // A dot at the end says that the name is complete.
        let name = name.trim_end_matches('.');
        is_address || self.0.iter().any(|ours| ours.eq_ignore_ascii_case(name))
    }
}

/// Whether a request comes from a page that was served here, or from no page at all. A script of any other site that the operator's
/// browser happens to show must not start or stop a recording.
pub fn is_own_page(request: &Request<Incoming>, is_secure: bool) -> bool {
    let text = |name| request.headers().get(name).map(|value| value.to_str().ok());
    match (text(ORIGIN), text(HOST)) {
        (None, _) => true,
        (Some(Some(origin)), Some(Some(host))) => is_of(origin, host, is_secure),
        _ => false,
    }
}

/// Whether an origin is the page of this host.
fn is_of(origin: &str, host: &str, is_secure: bool) -> bool {
    let scheme = if is_secure { "https://" } else { "http://" };
    origin.strip_prefix(scheme) == Some(host)
}

fn without_port(host: &str) -> &str {
    match host.rsplit_once(':') {
        Some((name, port)) if port.bytes().all(|b| b.is_ascii_digit()) => name,
        _ => host,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scripts_of_other_sites_are_strangers() {
        let (own, host) = ("http://127.0.0.1:8080", "127.0.0.1:8080");
        assert!(is_of(own, host, false) && is_of("https://127.0.0.1:8080", host, true));
        assert!(!is_of(own, host, true), "read on the way");
        for stranger in ["http://evil.example", "https://127.0.0.1:8080", "null", ""] {
            assert!(!is_of(stranger, host, false), "{stranger}");
        }
    }

    #[test]
    fn addresses_and_own_names_are_ours_and_no_others() {
        let names = Names::of("rig7", &["scanner.example".to_owned()]);
        for ours in [
            "127.0.0.1:8700",
            "192.168.1.5",
            "[::1]:8700",
            "[fe80::1]",
            "localhost:8700",
            "LOCALHOST",
            "rig7",
            "rig7.local:8700",
            "rig7.local.:80",
            "scanner.example:1",
        ] {
            assert!(names.include(ours), "{ours}");
        }
        for others in [
            "",
            ":8700",
            "evil.example:8700",
            "127.0.0.1.evil.example",
            "rig7.evil.example",
            "localhost.evil.example:8700",
            "127.0.0.1:80@evil.example",
        ] {
            assert!(!names.include(others), "{others}");
        }
        assert!(!Names::of("", &[]).include(""));
    }
}
