use std::io::Write;

use etherparse::PacketBuilder;
use pcap_file::pcap::{PcapHeader, PcapPacket, PcapWriter};
use pcap_file::pcapng::PcapNgWriter;
use pcap_file::pcapng::blocks::enhanced_packet::EnhancedPacketBlock;
use pcap_file::pcapng::blocks::interface_description::InterfaceDescriptionBlock;

use super::*;

fn frame(vlan: Option<u16>, port: u16, payload: &[u8]) -> Vec<u8> {
    let link = PacketBuilder::ethernet2([1; 6], [2; 6]);
    let mut bytes = Vec::new();
    match vlan {
        Some(id) => {
            let id = id.try_into().unwrap();
            let builder = link
                .single_vlan(id)
                .ipv4([192, 168, 1, 201], [255; 4], 64)
                .udp(443, port);
            builder.write(&mut bytes, payload).unwrap();
        }
        None => {
            let builder = link.ipv4([192, 168, 1, 201], [255; 4], 64).udp(443, port);
            builder.write(&mut bytes, payload).unwrap();
        }
    }
    bytes
}

fn pcap(link: DataLink, resolution: TsResolution, frames: &[Vec<u8>]) -> tempfile::NamedTempFile {
    let file = tempfile::NamedTempFile::new().unwrap();
    let header = PcapHeader {
        datalink: link,
        ts_resolution: resolution,
        ..PcapHeader::default()
    };
    let mut writer = PcapWriter::with_header(file.reopen().unwrap(), header).unwrap();
    for (n, bytes) in frames.iter().enumerate() {
        let stamp = Duration::new(1_700_000_000 + n as u64, 123_456_789);
        writer
            .write_packet(&PcapPacket::new(stamp, bytes.len() as u32, bytes))
            .unwrap();
    }
    file
}

fn all(source: &mut PcapSource) -> Vec<Packet> {
    let mut packets = Vec::new();
    while let Ok(Some(packet)) = source.recv(Duration::ZERO) {
        packets.push(packet);
    }
    packets
}

#[test]
fn ethernet_vlan_cooked_and_raw_frames_give_their_payload() {
    let plain = frame(None, 2368, b"plain");
    let frames = [
        plain.clone(),
        frame(Some(7), 2368, b"tagged"),
        frame(None, 8308, b"other port"),
        vec![1, 2, 3],
    ];
    let file = pcap(DataLink::ETHERNET, TsResolution::NanoSecond, &frames);
    let mut source = PcapSource::open(file.path(), &[2368]).unwrap();
    let packets = all(&mut source);
    assert_eq!(
        packets
            .iter()
            .map(|p| p.bytes.as_slice())
            .collect::<Vec<_>>(),
        [&b"plain"[..], b"tagged"]
    );
    assert_eq!(packets[1].arrival.nanos(), 1_700_000_001_123_456_789);
    assert_eq!(source.skipped(), 2);
    assert!(matches!(
        source.recv(Duration::ZERO),
        Err(Error::EndOfStream { .. })
    ));

    let mut cooked = vec![0, 0, 0, 1, 0, 6, 2, 2, 2, 2, 2, 2, 0, 0, 8, 0];
    cooked.extend_from_slice(&plain[14..]);
    for (link, bytes) in [
        (DataLink::LINUX_SLL, cooked),
        (DataLink::RAW, plain[14..].to_vec()),
    ] {
        let file = pcap(link, TsResolution::MicroSecond, &[bytes]);
        let packets = all(&mut PcapSource::open(file.path(), &[]).unwrap());
        assert_eq!(packets[0].bytes, b"plain", "{link:?}");
        assert_eq!(packets[0].arrival.nanos(), 1_700_000_000_123_456_000);
    }
}

/// The frame of a whole datagram, as two fragments with `options` in their headers.
fn fragments(id: u16, port: u16, payload: &[u8], options: &[u8]) -> [Vec<u8>; 2] {
    const FIRST_LEN: usize = 800;
    let mut udp = Vec::new();
    let len = 8 + payload.len() as u16;
    for word in [443, port, len, 0] {
        udp.extend(word.to_be_bytes());
    }
    udp.extend_from_slice(payload);
    let (first, second) = udp.split_at(FIRST_LEN);
    let part = |offset: usize, more_fragments, part: &[u8]| {
        let mut header = etherparse::Ipv4Header {
            identification: id,
            dont_fragment: false,
            more_fragments,
            fragment_offset: (offset as u16 / 8).try_into().unwrap(),
            protocol: etherparse::IpNumber::UDP,
            source: [192, 168, 1, 201],
            destination: [255; 4],
            options: options.try_into().unwrap(),
            ..Default::default()
        };
        header.set_payload_len(part.len()).unwrap();
        header.header_checksum = header.calc_header_checksum();
        let mut bytes = frame(None, port, b"")[..14].to_vec();
        header.write(&mut bytes).unwrap();
        bytes.extend_from_slice(part);
        bytes
    };
    [part(0, true, first), part(FIRST_LEN, false, second)]
}

#[test]
fn fragments_are_put_together_in_any_order() {
    let [a1, a2] = fragments(7, 2368, &[1; 1206], &[]);
    let [b1, b2] = fragments(8, 2368, &[2; 1206], &[1; 8]);
    let [other1, other2] = fragments(9, 8308, &[3; 1206], &[]);
    let [lonely, _] = fragments(10, 2368, &[4; 1206], &[]);
    let frames = [
        a1.clone(),
        b2,
        a2.clone(),
        lonely,
        other1,
        b1,
        other2,
        a1,
        a2,
    ];
    let file = pcap(DataLink::ETHERNET, TsResolution::NanoSecond, &frames);
    let mut source = PcapSource::open(file.path(), &[2368]).unwrap();
    let packets = all(&mut source);
    let seen: Vec<_> = packets
        .iter()
        .map(|p| (p.bytes[0], p.bytes.len()))
        .collect();
    assert_eq!(seen, [(1, 1206), (2, 1206), (1, 1206)]);
    // The stamp is that of the fragment that came last.
    assert_eq!(packets[0].arrival.nanos(), 1_700_000_002_123_456_789);
    assert_eq!(source.skipped(), 1);

    // Parts that contradict each other give nothing, and many beginnings do not pile up.
    let [first, mut second] = fragments(7, 2368, &[1; 1206], &[]);
    second.extend([0; 9]);
    second[16..18].copy_from_slice(&(20 + 423u16).to_be_bytes());
    let mut frames = vec![first, second.clone(), second];
    frames.extend((100..200).map(|id| fragments(id, 2368, &[5; 1206], &[])[0].clone()));
    let file = pcap(DataLink::ETHERNET, TsResolution::NanoSecond, &frames);
    let mut source = PcapSource::open(file.path(), &[2368]).unwrap();
    assert!(
        all(&mut source)
            .iter()
            .all(|p| p.bytes[..1206] == [1; 1206])
    );
    assert!(source.fragments.len() <= 16);
}

#[test]
fn ip_options_and_stacked_tags_do_not_hide_the_payload() {
    let plain = frame(None, 2368, b"plain");
    let mut with_options = plain[..14].to_vec();
    let mut header = etherparse::Ipv4Header::from_slice(&plain[14..]).unwrap().0;
    header.options = [1, 1, 1, 1, 7, 4, 4, 0].as_slice().try_into().unwrap();
    header.total_len += 8;
    header.header_checksum = header.calc_header_checksum();
    header.write(&mut with_options).unwrap();
    with_options.extend_from_slice(&plain[34..]);
    let mut stacked = plain[..12].to_vec();
    stacked.extend([0x88, 0xA8, 0, 5, 0x81, 0, 0, 7]);
    stacked.extend_from_slice(&plain[12..]);
    let frames = [with_options, stacked];
    let file = pcap(DataLink::ETHERNET, TsResolution::NanoSecond, &frames);
    let packets = all(&mut PcapSource::open(file.path(), &[2368]).unwrap());
    assert_eq!(packets.len(), 2);
    assert!(packets.iter().all(|p| p.bytes == b"plain"));
}

#[test]
fn an_ip_length_beyond_the_frame_does_not_hide_the_payload() {
    let mut bytes = frame(None, 8308, &[9; 512]);
    bytes[16..18].copy_from_slice(&1234u16.to_be_bytes());
    let file = pcap(DataLink::ETHERNET, TsResolution::MicroSecond, &[bytes]);
    let packets = all(&mut PcapSource::open(file.path(), &[8308]).unwrap());
    assert_eq!(packets[0].bytes, vec![9; 512]);
}

#[test]
fn pcapng_keeps_the_resolution_of_its_interface() {
    for (resolution, expected_ns) in [
        (None, 1_700_000_000_123_456_000),
        (Some(9), 1_700_000_000_123_456_789),
    ] {
        let file = tempfile::NamedTempFile::new().unwrap();
        let mut writer = PcapNgWriter::new(file.reopen().unwrap()).unwrap();
        let mut interface = InterfaceDescriptionBlock::new(DataLink::ETHERNET, 65_535);
        interface
            .options
            .extend(resolution.map(InterfaceDescriptionOption::IfTsResol));
        writer.write_pcapng_block(interface).unwrap();
        let data = frame(None, 2368, b"payload");
        let ticks = if resolution.is_some() {
            expected_ns
        } else {
            expected_ns / 1000
        };
        let block = EnhancedPacketBlock {
            interface_id: 0,
            timestamp: Duration::from_nanos(ticks),
            original_len: data.len() as u32,
            data: data.into(),
            options: Vec::new(),
        };
        writer.write_pcapng_block(block).unwrap();
        drop(writer);
        let packets = all(&mut PcapSource::open(file.path(), &[2368]).unwrap());
        assert_eq!(packets[0].bytes, b"payload");
        assert_eq!(packets[0].arrival.nanos(), expected_ns as i64);
    }
    assert_eq!(nanos_of(3 << 31, 0x80 | 31), 3_000_000_000);
    assert_eq!(nanos_of(u128::MAX, 0x80), i64::MAX);
    assert_eq!(nanos_of(5_000_000_000_000, 12), 5_000_000_000);
}

/// What older programs wrote was passed over without a word, and what have no time too.
#[test]
fn older_blocks_of_pcapng_are_read_and_those_without_a_time_are_an_error() {
    let data = frame(None, 2368, b"payload");
    let padded = data.len().next_multiple_of(4);
    // By the draft of the format, section by section: kind, length, body, length.
    let block = |kind: u32, body: &[u8]| {
        let length = (12 + body.len() as u32).to_le_bytes();
        [&kind.to_le_bytes()[..], &length, body, &length].concat()
    };
    let le = |words: &[u32]| -> Vec<u8> { words.iter().flat_map(|w| w.to_le_bytes()).collect() };
    let section = block(0x0A0D_0D0A, &le(&[0x1A2B_3C4D, 1, u32::MAX, u32::MAX]));
    let interface = block(1, &le(&[1, 65_535]));
    let mut bytes = data.clone();
    bytes.resize(padded, 0);
    let micros: u64 = 1_700_000_000_123_456;
    let [high, low] = [(micros >> 32) as u32, micros as u32];
    let length = data.len() as u32;
    let old = block(
        2,
        &[&le(&[0, high, low, length, length])[..], &bytes].concat(),
    );
    let simple = block(3, &[&le(&[length])[..], &bytes].concat());
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), [section, interface, old, simple].concat()).unwrap();
    let mut source = PcapSource::open(file.path(), &[2368]).unwrap();
    let packet = source.recv(Duration::ZERO).unwrap().unwrap();
    assert_eq!(packet.bytes, b"payload");
    assert_eq!(packet.arrival.nanos(), 1_700_000_000_123_456_000);
    let error = source.recv(Duration::ZERO).unwrap_err().to_string();
    assert!(error.contains("have no time"), "{error}");
}

#[test]
fn damaged_files_say_where_and_give_what_came_before() {
    let frames = [frame(None, 2368, b"one"), frame(None, 2368, b"two")];
    let file = pcap(DataLink::ETHERNET, TsResolution::MicroSecond, &frames);
    let whole = std::fs::read(file.path()).unwrap();
    let mut cut = tempfile::NamedTempFile::new().unwrap();
    cut.write_all(&whole[..whole.len() - 5]).unwrap();
    let mut source = PcapSource::open(cut.path(), &[2368]).unwrap();
    assert_eq!(source.recv(Duration::ZERO).unwrap().unwrap().bytes, b"one");
    let error = source.recv(Duration::ZERO).unwrap_err().to_string();
    assert!(
        error.contains("frame 1") && error.contains("truncated"),
        "{error}"
    );
    assert!(matches!(
        source.recv(Duration::ZERO),
        Err(Error::EndOfStream { .. })
    ));

    let mut text = tempfile::NamedTempFile::new().unwrap();
    text.write_all(b"this is no capture at all, only some text")
        .unwrap();
    let error = PcapSource::open(text.path(), &[])
        .err()
        .unwrap()
        .to_string();
    assert!(error.contains("neither pcap nor pcapng"), "{error}");
    let mut packed = tempfile::NamedTempFile::new().unwrap();
    packed.write_all(&[0x1F, 0x8B, 8, 0, 0, 0]).unwrap();
    let folder = tempfile::tempdir().unwrap();
    for (path, words) in [(packed.path(), "gunzip"), (folder.path(), "a folder")] {
        let error = PcapSource::open(path, &[]).err().unwrap().to_string();
        assert!(error.contains(words), "{error}");
    }
    let missing = PcapSource::open(Path::new("/no/such/file.pcap"), &[])
        .err()
        .unwrap()
        .to_string();
    assert!(missing.contains("/no/such/file.pcap"), "{missing}");
}

#[test]
fn mutated_captures_never_panic() {
    let frames: Vec<Vec<u8>> = (0..20).map(|n| frame(None, 2368, &[n; 40])).collect();
    let whole =
        std::fs::read(pcap(DataLink::ETHERNET, TsResolution::MicroSecond, &frames).path()).unwrap();
    let file = tempfile::NamedTempFile::new().unwrap();
    for at in 0..whole.len().min(400) {
        let mut bad = whole.clone();
        bad[at] ^= 0xFF;
        std::fs::write(file.path(), &bad).unwrap();
        if let Ok(mut source) = PcapSource::open(file.path(), &[]) {
            assert!(all(&mut source).len() <= 20);
        }
    }
}
