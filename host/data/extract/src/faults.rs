//! What cannot be read of a file: the first of it in words, all of it counted.

/// A list of limited length.
#[derive(Clone, Debug)]
pub struct Faults {
    first: Vec<String>,
    count: u64,
    limit: usize,
}

impl Faults {
    /// An empty list that keeps the words of at most `limit`.
    #[must_use]
    pub fn new(limit: usize) -> Self {
        Self {
            first: Vec::new(),
            count: 0,
            limit,
        }
    }

    /// One more.
    pub fn add(&mut self, what: String) {
        self.count += 1;
        if self.first.len() < self.limit {
            self.first.push(what);
        }
    }

    /// How many there are.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.count
    }

    /// The words of the first.
    #[must_use]
    pub fn first(&self) -> &[String] {
        &self.first
    }

    /// The words of the first, and how many there are beyond them, of a `kind`.
    #[must_use]
    pub fn words(&self, kind: &str) -> Vec<String> {
        let more = self.count - self.first.len() as u64;
        let more = (more > 0).then(|| format!("and {more} more {kind}"));
        self.first.iter().cloned().chain(more).collect()
    }
}
