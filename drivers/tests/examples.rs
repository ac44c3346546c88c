//! The example that needs no sensor does what it says.

use std::process::Command;

use lsfb_drivers::transport::save::{Encapsulation, PcapWriter};
use lsfb_types::{Packet, Timestamp};

/// Points of the packet, by `vectors/velodyne_vectors.json`.
const POINTS: usize = 384;

#[test]
fn points_of_a_capture_become_a_table() {
    let Some(example) = lsfb_tests::example("points_of_a_capture_become_a_table", "pcap_to_csv")
    else {
        return;
    };
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("drive.pcap");
    let to_the_data_port = Encapsulation::Udp { port_of: |_| 2368 };
    let mut capture = PcapWriter::create(&path, to_the_data_port).expect("file");
    let packet = Packet {
        arrival: Timestamp::from_nanos(1_772_359_200_000_000_000),
        bytes: include_bytes!("vectors/vlp32c_strongest_wrap.bin").to_vec(),
    };
    capture.write(&packet).expect("written");
    capture.finish().expect("written");
    let output = Command::new(example)
        .arg(&path)
        .output()
        .expect("the example");
    assert!(output.status.success(), "{output:?}");
    let table = String::from_utf8(output.stdout).expect("text");
    let mut lines = table.lines();
    assert_eq!(
        lines.next(),
        Some("scan,x_m,y_m,z_m,intensity,ring,echo,time_ns")
    );
    let mut points = 0;
    for line in lines {
        let columns: Vec<&str> = line.split(',').collect();
        let range_m = columns[1..4]
            .iter()
            .map(|c| c.parse::<f64>().expect("metres").powi(2));
        assert!(columns.len() == 8 && range_m.sum::<f64>() > 0.0, "{line}");
        points += 1;
    }
    assert_eq!(points, POINTS);
}
