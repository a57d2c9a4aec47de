//! C = start + A B in f32 with vectors, the product behind all three products of a layer.
//!
//! A is read one number at a time, and the lanes of a vector lie along the rows of B and C. C is computed in tiles. A
//! tile stays in registers while the inner index runs.

use super::vector::Vector;

/// The operands of C = start + A B, all row-major. A *stride* is how many numbers lie from one row to the next.
#[derive(Clone, Copy)]
pub(super) struct Product {
    /// Rows of A and C.
    pub(crate) rows: usize,
    /// Columns of B and C.
    pub(crate) columns: usize,
    /// Columns of A and rows of B.
    pub(crate) inner: usize,
    pub(crate) a: *const f32,
    pub(crate) a_row_stride: usize,
    /// How many numbers lie from one column of A to the next: 1, or more if memory holds A's transpose.
    pub(crate) a_column_stride: usize,
    pub(crate) b: *const f32,
    /// The stride of B, or of B's transpose if memory holds the transpose.
    pub(crate) b_stride: usize,
    pub(crate) b_is_transposed: bool,
    /// Whether C has one more row, the sum of B's rows.
    pub(crate) sums_b: bool,
    /// C, whose stride is `columns`.
    pub(crate) c: *mut f32,
    /// Room for a strip of B: [`strip_len`] of `inner` if B is transposed, else [`PACKED`] numbers.
    pub(crate) scratch: *mut f32,
}

/// A strip of B of up to so many numbers is copied to rows that follow each other. They fill half of an L1 cache.
pub(super) const PACKED: usize = 16 * 256;

/// Rows of the tallest tile.
pub(super) const TALLEST: usize = 12;

/// Numbers of scratch that a strip of B takes: `inner` rows of four vectors of 16 lanes, and at least [`PACKED`].
pub(super) const fn strip_len(inner: usize) -> usize {
    if inner * 64 > PACKED { inner * 64 } else { PACKED }
}

/// The initial value of an accumulator (bias, or else 0), and what happens to the sum before it is stored (ReLU or mask,
/// or else nothing). Only the first `lanes` lanes are valid.
pub(super) trait Epilogue: Copy {
    /// # Safety
    /// The CPU has V's instruction set, and the `lanes` numbers from (`row`, `column`) on lie in C.
    #[inline(always)]
    unsafe fn start<V: Vector>(self, _row: usize, _column: usize, _lanes: usize) -> V {
        // SAFETY: the caller vouches for the instruction set.
        unsafe { V::splat(0.0) }
    }

    /// # Safety
    /// As for [`Self::start`].
    #[inline(always)]
    unsafe fn finish<V: Vector>(self, sum: V, _row: usize, _column: usize, _lanes: usize) -> V {
        sum
    }
}

/// Starts at 0 and stores the sum as it is.
#[derive(Clone, Copy)]
pub(super) struct Plain;

/// Starts at the bias of C's row, or else column, and stores the sum through ReLU if `relu`. `bias` has one for each.
#[derive(Clone, Copy)]
pub(super) struct Bias<const OF_ROW: bool> {
    pub(crate) bias: *const f32,
    pub(crate) relu: bool,
}

/// Starts at 0, and stores the sum where the same element of `x`, of C's shape with `columns` columns, is above 0, else 0.
#[derive(Clone, Copy)]
pub(super) struct WherePositive {
    pub(crate) x: *const f32,
    pub(crate) columns: usize,
}

impl Epilogue for Plain {}

impl<const OF_ROW: bool> Epilogue for Bias<OF_ROW> {
    #[inline(always)]
    unsafe fn start<V: Vector>(self, row: usize, column: usize, lanes: usize) -> V {
        // SAFETY: the caller vouches for the instruction set, and the numbers lie in a row of C.
        unsafe { if OF_ROW { V::splat(*self.bias.add(row)) } else { load(self.bias.add(column), lanes) } }
    }
    #[inline(always)]
    unsafe fn finish<V: Vector>(self, sum: V, _: usize, _: usize, _: usize) -> V {
        if self.relu { sum.relu() } else { sum }
    }
}

impl Epilogue for WherePositive {
    #[inline(always)]
    unsafe fn finish<V: Vector>(self, sum: V, row: usize, column: usize, lanes: usize) -> V {
        // SAFETY: `x` has the shape of C, in which the numbers lie.
        unsafe { load::<V>(self.x.add(row * self.columns + column), lanes) }.positive_then(sum)
    }
}

impl Product {
    /// Computes C in tiles. A strip is up to four vectors of columns, and a tile as many rows of the strip as the
    /// registers hold, at most `MAX_HEIGHT`.
    ///
    /// The last strip begins early enough to be full. The columns that it shares with the strip before are computed
    /// twice. Only a C that is narrower than one vector is computed with a part of a vector.
    ///
    /// # Safety
    /// The CPU has V's instruction set. The pointers are valid for the operands, as the fields describe them, and the
    /// operands do not overlap with C or the scratch.
    #[inline(always)]
    pub(super) unsafe fn compute<V: Vector, const MAX_HEIGHT: usize>(self, epilogue: impl Epilogue) {
        // SAFETY: the caller vouches for the operands. Every strip ends at C's last column or before.
        unsafe {
            if self.columns < V::LANES {
                return self.strip::<V, 1, false, MAX_HEIGHT>(epilogue, 0);
            }
            let mut column = 0;
            while column < self.columns {
                let vectors = (self.columns - column).div_ceil(V::LANES).min(self.columns / V::LANES);
                let width = match vectors {
                    1..=2 => vectors,
                    // A page loads every width that there is.
                    _ if cfg!(target_arch = "wasm32") => 2,
                    3 => 3,
                    _ if self.rows <= 2 => 4,
                    5 => 3,
                    _ => 2,
                };
                column = column.min(self.columns - width * V::LANES);
                match width {
                    1 => self.strip::<V, 1, true, MAX_HEIGHT>(epilogue, column),
                    2 => self.strip::<V, 2, true, MAX_HEIGHT>(epilogue, column),
                    3 => self.strip::<V, 3, true, MAX_HEIGHT>(epilogue, column),
                    _ => self.strip::<V, 4, true, MAX_HEIGHT>(epilogue, column),
                }
                column += width * V::LANES;
            }
        }
    }

    /// Computes `WIDTH` vectors of columns from `column` on. Without `FULL`, C is narrower than one vector, and partial
    /// loads and stores are used.
    ///
    /// # Safety
    /// As for [`Self::compute`], and the columns lie in C.
    #[inline(always)]
    unsafe fn strip<V: Vector, const WIDTH: usize, const FULL: bool, const MAX_HEIGHT: usize>(
        self, epilogue: impl Epilogue, column: usize,
    ) {
        // SAFETY: the caller vouches for the operands. Every tile ends at C's last row or before. The sum of B's rows
        // is their product with ones, and its row follows C's other rows.
        unsafe {
            let strip = if self.b_is_transposed {
                self.transposed::<V, WIDTH, FULL>(column)
            } else {
                let strip = Self { b: self.b.add(column), ..self };
                if FULL && MAX_HEIGHT > 1 { strip.packed::<V, WIDTH>() } else { strip }
            };
            let mut row = 0;
            macro_rules! tiles {
                ($($height:literal)*) => {{$(
                    let fits = $height == 1 || ($height <= MAX_HEIGHT && ($height + 1) * WIDTH < V::REGISTERS);
                    while fits && self.rows - row >= $height {
                        strip.tile::<V, $height, WIDTH, FULL>(epilogue, row, column);
                        row += $height;
                    }
                )*}};
            }
            match WIDTH {
                1 => tiles!(12 4 1),
                2 => tiles!(12 6 4 2 1),
                3 => tiles!(8 3 2 1),
                _ => tiles!(2 1),
            }
            if self.sums_b {
                let ones = Self { a: &1.0, a_row_stride: 0, a_column_stride: 0, ..strip };
                ones.tile::<V, 1, WIDTH, FULL>(epilogue, row, column);
            }
        }
    }

    /// Transposes a strip of B, so that its rows follow each other in the scratch.
    ///
    /// # Safety
    /// As for [`Self::strip`], and memory holds B's transpose.
    #[inline(always)]
    unsafe fn transposed<V: Vector, const WIDTH: usize, const FULL: bool>(self, column: usize) -> Self {
        let width = WIDTH * V::LANES;
        let columns = if FULL { width } else { self.columns };
        // SAFETY: the columns lie in B, and the scratch has room for `inner` rows of four vectors.
        unsafe {
            let from = self.b.add(column * self.b_stride);
            transpose::<V>(from, self.b_stride, columns, self.inner, self.scratch, width);
        }
        Self { b: self.scratch, b_stride: width, ..self }
    }

    /// Copies a strip of B that is read often to consecutive rows of the scratch. Rows a power of two apart share cache sets.
    ///
    /// # Safety
    /// As for [`Self::strip`], and `b` is where the strip begins.
    #[inline(always)]
    unsafe fn packed<V: Vector, const WIDTH: usize>(self) -> Self {
        let width = WIDTH * V::LANES;
        if self.rows < 32 || self.inner < 32 || self.inner * width > PACKED {
            return self;
        }
        for row in 0..self.inner {
            for vector in 0..WIDTH {
                // SAFETY: the vectors of the strip lie in B, and the strip fits into the `PACKED` numbers of the
                // scratch.
                unsafe {
                    let value = V::load(self.b.add(row * self.b_stride + vector * V::LANES));
                    value.store(self.scratch.add(row * width + vector * V::LANES));
                }
            }
        }
        Self { b: self.scratch, b_stride: width, ..self }
    }

    /// Computes `HEIGHT` rows of a strip, with the sums in registers.
    ///
    /// # Safety
    /// As for [`Self::strip`], `b` is where the strip begins, and the rows lie in C.
    #[inline(always)]
    unsafe fn tile<V: Vector, const HEIGHT: usize, const WIDTH: usize, const FULL: bool>(
        self, epilogue: impl Epilogue, row: usize, column: usize,
    ) {
        let lanes = if FULL { V::LANES } else { self.columns };
        // SAFETY: the caller vouches for the instruction set, and for the rows and columns, which lie in A, B and C.
        // The pointers to A and B are used only while the inner index is inside of both.
        unsafe {
            let mut sums = [[V::splat(0.0); WIDTH]; HEIGHT];
            for (i, sums) in sums.iter_mut().enumerate() {
                for (j, sum) in sums.iter_mut().enumerate() {
                    *sum = epilogue.start(row + i, column + j * V::LANES, lanes);
                }
            }
            let (mut a, mut b) = (self.a.add(row * self.a_row_stride), self.b);
            for _ in 0..self.inner {
                let mut terms = [V::splat(0.0); WIDTH];
                for (j, term) in terms.iter_mut().enumerate() {
                    *term = load(b.add(j * V::LANES), lanes);
                }
                for (i, sums) in sums.iter_mut().enumerate() {
                    let factor = V::splat(*a.add(i * self.a_row_stride));
                    for (sum, &term) in sums.iter_mut().zip(&terms) {
                        *sum = factor.mul_add(term, *sum);
                    }
                }
                a = a.wrapping_add(self.a_column_stride);
                b = b.wrapping_add(self.b_stride);
            }
            for (i, sums) in sums.iter().enumerate() {
                for (j, &sum) in sums.iter().enumerate() {
                    let (row, column) = (row + i, column + j * V::LANES);
                    let value = epilogue.finish(sum, row, column, lanes);
                    store(value, self.c.add(row * self.columns + column), lanes);
                }
            }
        }
    }
}

/// Transposes a row-major matrix of `rows` and `columns`, in blocks and then number by number.
///
/// # Safety
/// The CPU has V's instruction set. `from` is valid for reads of the matrix with the stride `from_stride`, and `to` for
/// writes of its transpose with the stride `to_stride`.
#[inline(always)]
pub(super) unsafe fn transpose<V: Vector>(
    from: *const f32, from_stride: usize, rows: usize, columns: usize, to: *mut f32, to_stride: usize,
) {
    let (whole_rows, whole_columns) = (rows - rows % V::BLOCK, columns - columns % V::BLOCK);
    for column in (0..whole_columns).step_by(V::BLOCK) {
        for row in (0..whole_rows).step_by(V::BLOCK) {
            // SAFETY: the block lies in the matrix, and its transpose in the transposed matrix.
            unsafe {
                let (from, to) = (from.add(row * from_stride + column), to.add(column * to_stride + row));
                V::transpose_block(from, from_stride, to, to_stride);
            }
        }
    }
    // SAFETY: `row` and `column` lie in the matrix.
    let copy = |row: usize, column: usize| unsafe {
        *to.add(column * to_stride + row) = *from.add(row * from_stride + column);
    };
    for column in whole_columns..columns {
        (0..whole_rows).for_each(|row| copy(row, column));
    }
    for row in whole_rows..rows {
        (0..columns).for_each(|column| copy(row, column));
    }
}

/// Loads `lanes` numbers, and 0 into the other lanes.
///
/// # Safety
/// The CPU has V's instruction set, `lanes` is at most `V::LANES`, and `source` is valid for `lanes` reads.
#[inline(always)]
pub(super) unsafe fn load<V: Vector>(source: *const f32, lanes: usize) -> V {
    // SAFETY: the caller vouches for the instruction set and for `lanes` numbers.
    unsafe { if lanes == V::LANES { V::load(source) } else { V::load_part(source, lanes) } }
}

/// Stores the first `lanes` lanes.
///
/// # Safety
/// `lanes` is at most `V::LANES`, and `target` is valid for `lanes` writes.
#[inline(always)]
pub(super) unsafe fn store<V: Vector>(value: V, target: *mut f32, lanes: usize) {
    // SAFETY: the caller vouches for `lanes` numbers.
    unsafe { if lanes == V::LANES { value.store(target) } else { value.store_part(target, lanes) } }
}
