//! What topics say about their rhythm.

/// Whether a topic is of what a phone hears (networks, beacons, satellites): it comes when there is something to hear, seconds
/// after it was measured.
pub(crate) fn is_occasional(topic: &str) -> bool {
    let ends = ["/wifi", "/ble", "/gnss"];
    topic.starts_with("/sidecar/") && ends.iter().any(|end| topic.ends_with(end))
}
