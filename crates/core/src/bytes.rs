//! Converts numbers to bytes.

/// Appends each value as four little-endian bytes. The function exists because a caller may be
/// compiled without optimization, which would make the caller's own loop over many values slow.
pub fn append(bytes: &mut Vec<u8>, values: &[f32]) {
    let start = bytes.len();
    bytes.resize(start + size_of_val(values), 0);
    let (places, _) = bytes[start..].as_chunks_mut();
    places.iter_mut().zip(values).for_each(|(place, value)| *place = value.to_le_bytes());
}

#[cfg(test)]
mod tests {
    use super::append;

    #[test]
    fn values_follow_the_bytes_before_them() {
        let mut bytes = vec![7];
        append(&mut bytes, &[1.0, -0.0, f32::from_bits(0x0102_0304)]);
        assert_eq!(bytes, [7, 0, 0, 0x80, 0x3f, 0, 0, 0, 0x80, 4, 3, 2, 1]);
        append(&mut bytes, &[]);
        assert_eq!(bytes.len(), 13);
    }
}
