//! A 5 x 7 dot-matrix font: capitals, digits and a few marks.

/// Number of columns of a glyph.
pub(crate) const GLYPH_COLUMNS: usize = 5;
/// Number of rows of a glyph.
pub(crate) const GLYPH_ROWS: usize = 7;
/// Number of columns from one glyph to the next.
pub(crate) const ADVANCE: usize = GLYPH_COLUMNS + 1;

/// The glyphs. Each number is a row, from the top; bit 4 is the leftmost column.
const GLYPHS: [(char, [u8; GLYPH_ROWS]); 41] = [
    ('A', [0b01110, 0b10001, 0b10001, 0b11111, 0b10001, 0b10001, 0b10001]),
    ('B', [0b11110, 0b10001, 0b10001, 0b11110, 0b10001, 0b10001, 0b11110]),
    ('C', [0b01110, 0b10001, 0b10000, 0b10000, 0b10000, 0b10001, 0b01110]),
    ('D', [0b11110, 0b10001, 0b10001, 0b10001, 0b10001, 0b10001, 0b11110]),
    ('E', [0b11111, 0b10000, 0b10000, 0b11110, 0b10000, 0b10000, 0b11111]),
    ('F', [0b11111, 0b10000, 0b10000, 0b11110, 0b10000, 0b10000, 0b10000]),
    ('G', [0b01110, 0b10001, 0b10000, 0b10111, 0b10001, 0b10001, 0b01111]),
    ('H', [0b10001, 0b10001, 0b10001, 0b11111, 0b10001, 0b10001, 0b10001]),
    ('I', [0b01110, 0b00100, 0b00100, 0b00100, 0b00100, 0b00100, 0b01110]),
    ('J', [0b00111, 0b00010, 0b00010, 0b00010, 0b00010, 0b10010, 0b01100]),
    ('K', [0b10001, 0b10010, 0b10100, 0b11000, 0b10100, 0b10010, 0b10001]),
    ('L', [0b10000, 0b10000, 0b10000, 0b10000, 0b10000, 0b10000, 0b11111]),
    ('M', [0b10001, 0b11011, 0b10101, 0b10101, 0b10001, 0b10001, 0b10001]),
    ('N', [0b10001, 0b11001, 0b10101, 0b10011, 0b10001, 0b10001, 0b10001]),
    ('O', [0b01110, 0b10001, 0b10001, 0b10001, 0b10001, 0b10001, 0b01110]),
    ('P', [0b11110, 0b10001, 0b10001, 0b11110, 0b10000, 0b10000, 0b10000]),
    ('Q', [0b01110, 0b10001, 0b10001, 0b10001, 0b10101, 0b10010, 0b01101]),
    ('R', [0b11110, 0b10001, 0b10001, 0b11110, 0b10100, 0b10010, 0b10001]),
    ('S', [0b01111, 0b10000, 0b10000, 0b01110, 0b00001, 0b00001, 0b11110]),
    ('T', [0b11111, 0b00100, 0b00100, 0b00100, 0b00100, 0b00100, 0b00100]),
    ('U', [0b10001, 0b10001, 0b10001, 0b10001, 0b10001, 0b10001, 0b01110]),
    ('V', [0b10001, 0b10001, 0b10001, 0b10001, 0b10001, 0b01010, 0b00100]),
    ('W', [0b10001, 0b10001, 0b10001, 0b10101, 0b10101, 0b11011, 0b10001]),
    ('X', [0b10001, 0b10001, 0b01010, 0b00100, 0b01010, 0b10001, 0b10001]),
    ('Y', [0b10001, 0b10001, 0b01010, 0b00100, 0b00100, 0b00100, 0b00100]),
    ('Z', [0b11111, 0b00001, 0b00010, 0b00100, 0b01000, 0b10000, 0b11111]),
    ('0', [0b01110, 0b10001, 0b10011, 0b10101, 0b11001, 0b10001, 0b01110]),
    ('1', [0b00100, 0b01100, 0b00100, 0b00100, 0b00100, 0b00100, 0b01110]),
    ('2', [0b01110, 0b10001, 0b00001, 0b00110, 0b01000, 0b10000, 0b11111]),
    ('3', [0b11110, 0b00001, 0b00001, 0b01110, 0b00001, 0b00001, 0b11110]),
    ('4', [0b00010, 0b00110, 0b01010, 0b10010, 0b11111, 0b00010, 0b00010]),
    ('5', [0b11111, 0b10000, 0b11110, 0b00001, 0b00001, 0b10001, 0b01110]),
    ('6', [0b01110, 0b10000, 0b10000, 0b11110, 0b10001, 0b10001, 0b01110]),
    ('7', [0b11111, 0b00001, 0b00010, 0b00100, 0b01000, 0b01000, 0b01000]),
    ('8', [0b01110, 0b10001, 0b10001, 0b01110, 0b10001, 0b10001, 0b01110]),
    ('9', [0b01110, 0b10001, 0b10001, 0b01111, 0b00001, 0b00001, 0b01110]),
    ('+', [0b00000, 0b00100, 0b00100, 0b11111, 0b00100, 0b00100, 0b00000]),
    ('-', [0b00000, 0b00000, 0b00000, 0b11111, 0b00000, 0b00000, 0b00000]),
    ('.', [0b00000, 0b00000, 0b00000, 0b00000, 0b00000, 0b01100, 0b01100]),
    (',', [0b00000, 0b00000, 0b00000, 0b00000, 0b01100, 0b00100, 0b01000]),
    (':', [0b00000, 0b01100, 0b01100, 0b00000, 0b01100, 0b01100, 0b00000]),
];

/// Returns the width of a line of text in columns, without the gap after its last glyph.
pub(crate) fn columns(text: &str) -> usize {
    (text.chars().count() * ADVANCE).saturating_sub(1)
}

/// Returns true if the dot at `column` and `row` (from the top) of a line of text is set. Dots
/// outside of the line are not set.
///
/// Characters that the font lacks are blank.
pub(crate) fn is_set(text: &str, column: usize, row: usize) -> bool {
    let within = column % ADVANCE;
    if within >= GLYPH_COLUMNS || row >= GLYPH_ROWS {
        return false;
    }
    let Some(wanted) = text.chars().nth(column / ADVANCE) else { return false };
    GLYPHS
        .iter()
        .find(|(character, _)| *character == wanted)
        .is_some_and(|(_, rows)| rows[row] >> (GLYPH_COLUMNS - 1 - within) & 1 == 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_reads_from_left_to_right_and_top_to_bottom() {
        let drawn: Vec<String> = (0..GLYPH_ROWS)
            .map(|row| (0..columns("LF")).map(|c| if is_set("LF", c, row) { '#' } else { '.' }).collect())
            .collect();
        assert_eq!(
            drawn,
            ["#.....#####", "#.....#....", "#.....#....", "#.....####.", "#.....#....", "#.....#....", "#####.#....",]
        );
    }

    #[test]
    fn no_two_glyphs_look_alike() {
        for (k, (character, rows)) in GLYPHS.iter().enumerate() {
            for (other, other_rows) in &GLYPHS[k + 1..] {
                assert_ne!(rows, other_rows, "{character} and {other}");
            }
        }
    }
}
