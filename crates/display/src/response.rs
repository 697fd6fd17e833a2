//! The response of a layer's hardware to the stored values: the linear map A from mask pixels to
//! the values that rays read.
//!
//! ```text
//! F_c = Σ_c' crosstalk[c][c'] · blur(filter_c' · f_c')
//! ```
//!
//! The filters belong to the mask's columns. The blur is a Gaussian along both axes, whose weights
//! add up to 1 also at the borders. F_c is the value that rays read in channel c, and f_c' the
//! stored value of channel c'. On a `mono` layer the three stored channels are equal, so A maps one
//! value per pixel to three channels.

use lumistack_core::Tensor;

use crate::blur::PointSpread;
use crate::{Layer, LayerColour};

/// The linear map A of one layer; see the head of the file.
#[derive(Clone, Debug, PartialEq)]
pub struct Response {
    tied: bool,
    mix: [[f32; 3]; 3],
    /// RGB factors of the colour filters on successive columns; empty if there are no filters.
    filters: Vec<[f32; 3]>,
    spread: PointSpread,
}

const IDENTITY: [[f32; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

impl Layer {
    /// Returns the response of this layer's hardware. Returns `None` if rays read the stored values
    /// unchanged, and the three channels of a pixel are independent.
    pub fn response(&self) -> Option<Response> {
        let response = Response::of(self);
        (response.is_tied() || !response.is_identity()).then_some(response)
    }
}

impl Response {
    fn of(layer: &Layer) -> Self {
        let clear = layer.filters.iter().all(|filter| *filter == [1.0; 3]);
        Self {
            tied: layer.colour == LayerColour::Mono,
            mix: layer.crosstalk.map_or(IDENTITY, |rows| rows.map(|row| row.map(|share| share as f32))),
            filters: if clear { Vec::new() } else { layer.filters.iter().map(|f| f.map(|v| v as f32)).collect() },
            spread: PointSpread::gaussian(layer.blur_px),
        }
    }

    /// Returns true if the three channels of a pixel share one value.
    pub fn is_tied(&self) -> bool {
        self.tied
    }

    /// Returns true if rays read the stored values unchanged: without blur, colour filters or
    /// crosstalk.
    pub fn is_identity(&self) -> bool {
        !self.is_blurred() && self.filters.is_empty() && self.mix == IDENTITY
    }

    /// Returns true if there is any blur.
    pub fn is_blurred(&self) -> bool {
        !self.spread.is_identity()
    }

    /// Returns the crosstalk matrix: row = emitted channel, column = mask channel.
    pub fn mix(&self) -> [[f32; 3]; 3] {
        self.mix
    }

    /// Returns the RGB factors of the colour filter on a column.
    #[inline]
    pub fn filter(&self, col: usize) -> [f32; 3] {
        if self.filters.is_empty() { [1.0; 3] } else { self.filters[col % self.filters.len()] }
    }

    /// Returns the weights of the point spread, which are the same along both axes. They are
    /// symmetric, their number is odd, and their sum is 1.
    pub fn taps(&self) -> &[f32] {
        self.spread.taps()
    }

    /// Blurs one plane `input[row][col]` into `output`. Calls may share the working memory
    /// `scratch`.
    ///
    /// # Panics
    /// If a plane does not hold `rows · cols` values.
    pub fn blur(&self, rows: usize, cols: usize, input: &[f32], output: &mut [f32], scratch: &mut Vec<f32>) {
        self.spread.apply::<false>([rows, cols], input, output, scratch);
    }

    /// Applies the transpose of [`blur`](Self::blur): ⟨blur(x), y⟩ = ⟨x, blur_adjoint(y)⟩.
    ///
    /// # Panics
    /// If a plane does not hold `rows · cols` values.
    pub fn blur_adjoint(&self, rows: usize, cols: usize, input: &[f32], output: &mut [f32], scratch: &mut Vec<f32>) {
        self.spread.apply::<true>([rows, cols], input, output, scratch);
    }

    /// Applies filters, blur and crosstalk to the masks `[frame][row][col][rgb]` of the layer.
    pub fn apply(&self, layer: &Tensor<4>) -> Tensor<4> {
        let mut effective = layer.clone();
        let [frames, rows, cols, _] = layer.shape();
        let filters: Vec<[f32; 3]> = (0..cols).map(|col| self.filter(col)).collect();
        let mut stored = vec![0.0; rows * cols];
        let mut blurred = [(); 3].map(|()| vec![0.0; rows * cols]);
        let mut scratch = Vec::new();
        for frame in 0..frames {
            let frame = effective.block_mut([frame]);
            for (c, plane) in blurred.iter_mut().enumerate() {
                let columns = filters.iter().cycle();
                let pixels = frame.chunks_exact(3).zip(columns);
                stored.iter_mut().zip(pixels).for_each(|(stored, (rgb, filter))| *stored = filter[c] * rgb[c]);
                self.blur(rows, cols, &stored, plane, &mut scratch);
            }
            for (i, pixel) in frame.chunks_exact_mut(3).enumerate() {
                let rgb = [blurred[0][i], blurred[1][i], blurred[2][i]];
                for (value, row) in pixel.iter_mut().zip(&self.mix) {
                    *value = row[0] * rgb[0] + row[1] * rgb[1] + row[2] * rgb[2];
                }
            }
        }
        effective
    }
}
