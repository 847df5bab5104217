//! A window that slides over an image: convolutions and pooling share it.

use std::ops::Range;

use super::NetworkError;

/// Height, width and channels of an image; its values are in rows, then columns, then channels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct ImageShape {
    pub(super) height: usize,
    pub(super) width: usize,
    pub(super) channels: usize,
}

/// A window that slides over the images of one size.
#[derive(Clone, Copy, Debug)]
pub(super) struct Window {
    pub(super) input: ImageShape,
    /// Height and width of the output.
    pub(super) output: [usize; 2],
    /// Height and width of the window.
    pub(super) size: [usize; 2],
    stride: [usize; 2],
    /// How far the first window begins before the image.
    before: [usize; 2],
}

/// How the image is continued at its border.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Padding {
    /// By as much as gives `ceil(size / stride)` outputs.
    Same,
    /// Not at all.
    Valid,
}

impl Window {
    pub(super) fn new(
        input: ImageShape,
        size: [usize; 2],
        stride: [usize; 2],
        padding: Padding,
    ) -> Result<Self, NetworkError> {
        let (mut output, mut before) = ([0; 2], [0; 2]);
        for (i, length) in [input.height, input.width].into_iter().enumerate() {
            if size[i] == 0 || stride[i] == 0 || (padding == Padding::Valid && size[i] > length) {
                return Err(NetworkError::Shape);
            }
            output[i] = match padding {
                Padding::Same => length.div_ceil(stride[i]),
                Padding::Valid => (length - size[i]) / stride[i] + 1,
            };
            before[i] = ((output[i] - 1) * stride[i] + size[i]).saturating_sub(length) / 2;
        }
        if padding == Padding::Valid {
            before = [0; 2];
        }
        Ok(Self { input, output, size, stride, before })
    }

    /// Number of places of the window.
    pub(super) fn places(&self) -> usize {
        self.output[0] * self.output[1]
    }

    /// Values that are looked at in one run.
    pub(super) fn products(&self) -> usize {
        let size = self.size[0].saturating_mul(self.size[1]).saturating_mul(self.input.channels);
        self.places().saturating_mul(size)
    }

    /// Whether every place of the window is one pixel of the image, in the same order.
    pub(super) fn is_pixelwise(&self) -> bool {
        self.size == [1, 1] && self.stride == [1, 1]
    }

    /// The part of the window at a place that lies in the image: its rows and columns within the window, and the image's row and
    /// column where that part begins.
    pub(super) fn inside(&self, place: usize) -> ([Range<usize>; 2], [usize; 2]) {
        let at = [place / self.output[1], place % self.output[1]];
        let lengths = [self.input.height, self.input.width];
        let part = |i: usize| {
            let start = at[i] * self.stride[i];
            let first = self.before[i].saturating_sub(start);
            let last = self.size[i].min((lengths[i] + self.before[i]).saturating_sub(start));
            (first..last.max(first), start + first - self.before[i])
        };
        let ((rows, row), (columns, column)) = (part(0), part(1));
        ([rows, columns], [row, column])
    }
}
