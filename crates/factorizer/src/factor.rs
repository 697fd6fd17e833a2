//! Storage of one factor: a layer, or the directional backlight as one more layer.
//!
//! The order is `values[channel][line][frame][x]`. A line is one row of the factor's pixels with
//! their values in all frames. So a thread gets successive lines as one slice, and a ray's values
//! of all frames are near one another.
//!
//! Lines are padded by at least [`PAD`] values on both sides, and an extra line follows the last
//! line. The padding and the extra line hold the value that rays read if they miss the factor. So
//! inner loops have no branch for misses.
//!
//! The backlight has R × C lenslets per angular bin. Lenslet (row, column) of bin (bin_y, bin_x) is
//! the pixel at line bin_y·R + row and column bin_x·C + column. So the map of the backlight is
//! separable into lines and columns, like the map of a layer.

use crate::aligned::Aligned;
use crate::bands;

/// Smallest padding on both sides of a line, in values: the widest vector.
pub(crate) const PAD: usize = 16;

/// Sizes of a factor.
#[derive(Clone, Debug, PartialEq)]
pub struct Layout {
    /// Number of angular bins, [vertical, horizontal]; [1, 1] for a layer.
    pub(crate) bins: [usize; 2],
    /// Rows and columns within one bin.
    pub(crate) size: [usize; 2],
    /// Number of frames M.
    pub(crate) frames: usize,
    /// Number of values in front of the first column.
    pub(crate) pad: usize,
    /// Distance of the rows of successive frames, in values.
    pub(crate) stride: usize,
    /// Value that rays read if they miss the factor:
    /// [`Formation::neutral`](lumistack_display::Formation::neutral) for a layer, 0 for a
    /// backlight.
    pub(crate) outside: f32,
}

impl Layout {
    /// Returns the number of lines that rays can hit.
    pub(crate) fn lines(&self) -> usize {
        self.bins[0] * self.size[0]
    }

    /// Returns the number of columns that rays can hit.
    pub(crate) fn cols(&self) -> usize {
        self.bins[1] * self.size[1]
    }

    /// Returns the number of values of one line over all frames.
    pub(crate) fn line_len(&self) -> usize {
        self.frames * self.stride
    }

    /// Returns the number of lines of one channel, with the extra line for misses.
    pub(crate) fn stored_lines(&self) -> usize {
        self.lines() + 1
    }

    /// Returns the offset of a pixel's red value in the tensor of a layer or of the emission.
    pub(crate) fn tensor_offset(&self, frame: usize, line: usize, col: usize) -> usize {
        let ([bins_y, bins_x], [rows, cols]) = (self.bins, self.size);
        let (bin_y, row, bin_x, col) = (line / rows, line % rows, col / cols, col % cols);
        ((((frame * bins_y + bin_y) * bins_x + bin_x) * rows + row) * cols + col) * 3
    }
}

/// Values of one factor.
#[derive(Clone, Debug)]
pub struct Factor {
    pub(crate) layout: Layout,
    pub(crate) values: Aligned,
}

impl Factor {
    /// Copies a tensor's values, clamped to `low`..`high`.
    pub(crate) fn upload(layout: &Layout, tensor: &[f32], [low, high]: [f32; 2]) -> Self {
        let mut factor = Self::blank(layout, 3);
        // copy one line in all three channels together, so that every pixel of the tensor is read
        // once
        let (line_len, width) = (layout.line_len(), layout.size[1]);
        let (red, rest) = factor.values.split_at_mut(layout.stored_lines() * line_len);
        let (green, blue) = rest.split_at_mut(layout.stored_lines() * line_len);
        let [red, green, blue] = [red, green, blue].map(|channel| channel.chunks_exact_mut(line_len));
        let mut lines: Vec<_> = red.zip(green).zip(blue).take(layout.lines()).collect();
        bands::for_each_chunk(
            &mut lines,
            1,
            || (),
            |(), line, channels| {
                let ((red, green), blue) = &mut channels[0];
                for (frame, bin_x) in (0..layout.frames).flat_map(|frame| (0..layout.bins[1]).map(move |x| (frame, x)))
                {
                    let to = frame * layout.stride + layout.pad + bin_x * width;
                    let to = to..to + width;
                    let from = layout.tensor_offset(frame, line, bin_x * width);
                    let pixels = tensor[from..from + 3 * width].chunks_exact(3);
                    let values = red[to.clone()].iter_mut().zip(&mut green[to.clone()]).zip(&mut blue[to]);
                    for (((red, green), blue), pixel) in values.zip(pixels) {
                        *red = pixel[0].clamp(low, high);
                        *green = pixel[1].clamp(low, high);
                        *blue = pixel[2].clamp(low, high);
                    }
                }
            },
        );
        factor
    }

    /// Allocates a factor; every value is the value that rays read if they miss the factor.
    pub(crate) fn blank(layout: &Layout, channels: usize) -> Self {
        let values = Aligned::filled(layout.outside, channels * layout.stored_lines() * layout.line_len());
        Self { layout: layout.clone(), values }
    }

    /// Copies the values to a tensor.
    pub(crate) fn download(&self, tensor: &mut [f32]) {
        let ([bins_y, bins_x], [rows, cols]) = (self.layout.bins, self.layout.size);
        bands::for_each_chunk(
            tensor,
            cols * 3,
            || (),
            |(), index, pixels| {
                // the index is in the order `[frame][bin_y][bin_x][row]`
                let (row, bin_x) = (index % rows, index / rows % bins_x);
                let (bin_y, frame) = (index / rows / bins_x % bins_y, index / rows / bins_x / bins_y);
                let from = self.layout.pad + bin_x * cols;
                let channels =
                    [0, 1, 2].map(|channel| &self.row(channel, bin_y * rows + row, frame)[from..from + cols]);
                for (col, pixel) in pixels.chunks_exact_mut(3).enumerate() {
                    pixel.iter_mut().zip(channels).for_each(|(value, channel)| *value = channel[col]);
                }
            },
        );
    }

    /// Returns the number of colour channels.
    pub(crate) fn channels(&self) -> usize {
        self.values.len() / (self.layout.stored_lines() * self.layout.line_len())
    }

    /// Returns one padded row of one frame.
    #[inline(always)]
    pub(crate) fn row(&self, channel: usize, line: usize, frame: usize) -> &[f32] {
        let at = (channel * self.layout.stored_lines() + line) * self.layout.line_len() + frame * self.layout.stride;
        &self.values[at..at + self.layout.stride]
    }

    /// Returns one line in all frames: padded rows, one after another.
    #[inline(always)]
    pub(crate) fn line(&self, channel: usize, line: usize) -> &[f32] {
        let at = (channel * self.layout.stored_lines() + line) * self.layout.line_len();
        &self.values[at..at + self.layout.line_len()]
    }
}
