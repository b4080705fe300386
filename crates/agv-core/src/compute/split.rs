//! Structure-of-arrays data that a parallel loop can cut in two.

/// Data that can be cut at an index: slices, and tuples of slices of equal length.
///
/// The tuple forms are what a structure of arrays needs: `(&mut x, &mut y, &weights)` is cut as one.
pub trait Split: Sized + Send {
    /// Number of entries; for a tuple that of its shortest part.
    fn len(&self) -> usize;

    /// Whether there are no entries.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The entries before `mid`, and the rest. `mid` is at most [`len`](Self::len).
    fn split_at(self, mid: usize) -> (Self, Self);
}

impl<T: Sync> Split for &[T] {
    fn len(&self) -> usize {
        <[T]>::len(self)
    }

    fn split_at(self, mid: usize) -> (Self, Self) {
        <[T]>::split_at(self, mid)
    }
}

impl<T: Send> Split for &mut [T] {
    fn len(&self) -> usize {
        <[T]>::len(self)
    }

    fn split_at(self, mid: usize) -> (Self, Self) {
        <[T]>::split_at_mut(self, mid)
    }
}

macro_rules! split_tuple {
    ($($name:ident . $index:tt),+) => {
        impl<$($name: Split),+> Split for ($($name,)+) {
            fn len(&self) -> usize {
                usize::MAX$(.min(self.$index.len()))+
            }

            fn split_at(self, mid: usize) -> (Self, Self) {
                let parts = ($(self.$index.split_at(mid),)+);
                (($(parts.$index.0,)+), ($(parts.$index.1,)+))
            }
        }
    };
}

split_tuple!(A.0, B.1);
split_tuple!(A.0, B.1, C.2);
split_tuple!(A.0, B.1, C.2, D.3);
split_tuple!(A.0, B.1, C.2, D.3, E.4);
split_tuple!(A.0, B.1, C.2, D.3, E.4, F.5);
