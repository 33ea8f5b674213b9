//! What an extraction says while it works. A watcher of its files stops it ([`files::watch`]).

/// Somebody who watches.
pub trait Progress: Sync {
    /// A step begins that goes to `total` (bytes, frames, ns); 0: not known.
    fn begin(&self, what: &str, total: u64);

    /// How far the step is.
    fn at(&self, position: u64);

    /// The step is over.
    fn end(&self);
}

/// Nobody watches.
#[derive(Clone, Copy, Debug, Default)]
pub struct Silent;

impl Progress for Silent {
    fn begin(&self, _what: &str, _total: u64) {}

    fn at(&self, _position: u64) {}

    fn end(&self) {}
}
