use super::super::decode;

/// A grey JPEG of 8 × 8 pixels (libjpeg).
const SMALL: &str = "ffd8ffe000104a46494600010100000100010000ffdb004300080606070605080707070909080a0c140d0c0b0b0c1912130f141d1a1f1e1d1a1c1c20242e2720222c231c1c2837292c30313434341f27393d38323c2e333432ffc0000b080008000801011100ffc4001f0000010501010101010100000000000000000102030405060708090a0bffc400b5100002010303020403050504040000017d01020300041105122131410613516107227114328191a1082342b1c11552d1f02433627282090a161718191a25262728292a3435363738393a434445464748494a535455565758595a636465666768696a737475767778797a838485868788898a92939495969798999aa2a3a4a5a6a7a8a9aab2b3b4b5b6b7b8b9bac2c3c4c5c6c7c8c9cad2d3d4d5d6d7d8d9dae1e2e3e4e5e6e7e8e9eaf1f2f3f4f5f6f7f8f9faffda0008010100003f00f7faffd9";

/// Waves and noise, 56 × 40 pixels: grey; colour at half the resolution with a restart marker after every third unit, 44 × 36 pixels;
/// grey in several passes (libjpeg).
const GREY: &str = "ffd8ffe000104a46494600010100000100010000ffdb0043000d090a0b0a080d0b0a0b0e0e0d0f13201513121213271c1e17202e2931302e292d2c333a4a3e333646372c2d405741464c4e525352323e5a615a50604a51524fffc0000b080028003801011100ffc4001f0000010501010101010100000000000000000102030405060708090a0bffc400b5100002010303020403050504040000017d01020300041105122131410613516107227114328191a1082342b1c11552d1f02433627282090a161718191a25262728292a3435363738393a434445464748494a535455565758595a636465666768696a737475767778797a838485868788898a92939495969798999aa2a3a4a5a6a7a8a9aab2b3b4b5b6b7b8b9bac2c3c4c5c6c7c8c9cad2d3d4d5d6d7d8d9dae1e2e3e4e5e6e7e8e9eaf1f2f3f4f5f6f7f8f9faffda0008010100003f00e9ec2e238b4ec20e715c0789e596e2e0800fb735a7e14b2e41901e6b6b5c9a2860207a572b69712cf7385ce09ef5d04b665adf7393d2b1a3786daeb00a9e45765a5d916b0dee4fdde9e95c678a26860b92075cd4de1bba79b0a80e3a62b5f57b37788992b16c0c504f93b739ad6bebc67b52b1e71d2b9eb7b6924bb0cf93cf35dd457c4d8613278af3cd7a09a7bd39e99ae9bc216f1428bbb83deaf789ef02c44463b5719a7a4b3de64e719aed3eca9159fce413b6b9e9eed63b9db18e738aeced6d63874ff98ff0d79f7896ed16e8ac782735afe12135c019e86b635fb448ed8993ad72563791c7721540eb5d33b4b3db719c63deb0c598173ba5ec6ba65b8966b5e0718ed5c3ea9639bccbe473c5761e15686de15c6381daa1f16dd492c44292011815ca68764cf79b9c9fbd5e85886dec8600ce315c55fde3c977b13d78afffd9";
const COLOUR: &str = "ffd8ffe000104a46494600010100000100010000ffdb004300100b0c0e0c0a100e0d0e1211101318281a181616183123251d283a333d3c3933383740485c4e404457453738506d51575f626768673e4d71797064785c656763ffdb0043011112121815182f1a1a2f634238426363636363636363636363636363636363636363636363636363636363636363636363636363636363636363636363636363ffc00011080024002c03012200021101031101ffc400190001010101010100000000000000000000060500040307ffc4002510000105000104020203000000000000000200010304112105063151122214416171a1ffc4001501010100000000000000000000000000000001ffc4001511010100000000000000000000000000000001ffdd00040003ffda000c03010002110311003f00414ec0c347eadce7e90bee09649ac3e7b4c3a7547fc3d3f48b770491c333e66ea0e8edba8d8ce6ab758963861c1cd651fa158391d98153ea7508a3d3410eb4f24b6307fc5746a110b3beea914de3866fe75596b9c37c7c20ffd0b816dde9e071c213d66239acbb97b4e6ac01152d3cdc42baf5a11b2ec1ed05bed98238859dfcff006bafb82d644e20a6f6d3493b37954fad551089dcd015a032cd679dcd4b61a60d10b179c462a5a009f07da4711c871b3b7083ffd1a6731bd4f3fa436f809dbfb73cacb2a52fed911089be2ccbc7baa6378f35659420af48163b6ce5cf2be815a007847859641fffd9";
const PASSES: &str = "ffd8ffe000104a46494600010100000100010000ffdb0043000d090a0b0a080d0b0a0b0e0e0d0f13201513121213271c1e17202e2931302e292d2c333a4a3e333646372c2d405741464c4e525352323e5a615a50604a51524fffc2000b080028003801011100ffc4001800010101010100000000000000000000000504060203ffda00080101000000014c0a6d2908d917bb22ace773c9fb8ad1ece7ebb094e14c363827422fffc4001c1000020203010100000000000000000000010203040011222112ffda000801010001050246023b24b3554c9c801589629c8d2b449c5a203566de4a9e268177e554960fc4e097a8a06597f23d97f9d216d32a811d96eaa6db275d2a380de95f8ebe895953baba516d8910277e2a3bedbfffc40017100101010100000000000000000000000021103020ffda0008010100063f028e0c392908d70fffc4001b10000300030101000000000000000000000001111021514120ffda0008010100013f21d43e2117a914a63794a5be61cdd50e61cb1ce450b3c78f29549020a76705c06f5c12a704b04821b17a041fa8754d2063a7dc47451fffda0008010100000010bcc63580dfffc4001b10010101010101010100000000000000000111002131416151ffda0008010100013f10933d99e00fe777710f7250fe697a8bf73517cd142ba65aefe3f99187b742167933771def5722a4f309abdee666de6577cbbca8fdc4a0f9ab9b2ef5a2e4c9db3740c7905b8817c73d7d60207bb97b27ee01fcaee10e4f9a956779a01387cccc48243552e40c0b26fdafcdffd9";

fn bytes(digits: &str) -> Vec<u8> {
    let digits = digits.as_bytes().chunks(2);
    digits
        .map(|d| u8::from_str_radix(std::str::from_utf8(d).expect("ASCII"), 16).expect("hex"))
        .collect()
}

#[test]
fn a_jpeg_cut_short_is_not_read_as_whole() {
    let bytes = bytes(SMALL);
    let image = decode(&bytes).expect("an image");
    assert_eq!((image.width, image.height, image.pixels.len()), (8, 8, 64));
    for length in 2..bytes.len() {
        let error = decode(&bytes[..length]).expect_err("it is cut");
        assert!(error.contains("truncated"), "{length}: {error}");
    }
}

/// Where the data of the first scan begin.
fn data_from(bytes: &[u8]) -> usize {
    let scan = bytes.windows(2).position(|w| w == [0xff, 0xda]);
    let scan = scan.expect("a scan");
    scan + 2 + usize::from(bytes[scan + 3])
}

/// Once zeros in the middle were a smear in an image that was taken for whole.
#[test]
fn a_jpeg_with_bytes_zeroed_inside_is_refused() {
    for (what, digits, size) in [("grey", GREY, (56, 40)), ("colour", COLOUR, (44, 36))] {
        let whole = bytes(digits);
        let image = decode(&whole).expect("an image");
        assert_eq!((image.width, image.height), size);
        let (from, to) = (data_from(&whole), whole.len() - 2);
        // Few bytes may make room for as many blocks as they held.
        for (zeroed, least) in [(8, 0.75), (16, 0.9), (40, 1.0)] {
            let places: Vec<usize> = (from..to - zeroed).collect();
            let seen = places.iter().filter(|at| {
                let mut damaged = whole.clone();
                damaged[**at..**at + zeroed].fill(0);
                decode(&damaged).is_err_and(|e| e.contains("damaged JPEG"))
            });
            let share = seen.count() as f64 / places.len() as f64;
            assert!(share >= least, "{what}, {zeroed} bytes of zeros: {share}");
        }
        // Ten bytes that are gone: what is left may by chance be as many blocks.
        let places: Vec<usize> = (from..to - 10).collect();
        let seen = places.iter().filter(|at| {
            let mut shorter = whole.clone();
            shorter.drain(**at..**at + 10);
            decode(&shorter).is_err_and(|e| e.contains("damaged JPEG"))
        });
        let share = seen.count() as f64 / places.len() as f64;
        assert!(share >= 0.8, "{what}, ten bytes gone: {share}");
    }
    let mut without = bytes(COLOUR);
    let restart = without.windows(2).position(|w| w == [0xff, 0xd1]);
    let restart = restart.expect("the second restart");
    without.drain(restart..restart + 2);
    assert!(decode(&without).is_err());
}

/// Its data are not looked at: they are read as before.
#[test]
fn a_jpeg_in_several_passes_is_read() {
    let image = decode(&bytes(PASSES)).expect("an image");
    assert_eq!((image.width, image.height), (56, 40));
}
