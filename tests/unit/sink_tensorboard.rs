#![allow(clippy::unwrap_used)]

use super::*;

/// From TensorFlow's own tests (core/lib/hash/crc32c_test.cc, RFC 3720 B.4).
#[test]
fn checksums_are_crc_32c() {
    assert_eq!(CRC.checksum(&[0; 32]), 0x8a91_36aa);
    assert_eq!(CRC.checksum(&[0xff; 32]), 0x62a8_ab43);
}

#[test]
fn numbers_take_as_many_bytes_as_they_need() {
    let of = |value| {
        let mut bytes = Vec::new();
        varint(&mut bytes, value);
        bytes
    };
    assert_eq!(of(127), [0x7f]);
    assert_eq!(of(300), [0xac, 0x02]);
    assert_eq!(of(u64::MAX).len(), 10);
}
