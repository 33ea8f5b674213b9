//! Unreadable parts of a file: all are counted, the first of them described.

/// List of faults of limited length.
#[derive(Clone, Debug)]
pub(crate) struct Faults {
    first: Vec<String>,
    count: u64,
    limit: usize,
}

impl Faults {
    /// Creates an empty list that keeps the descriptions of at most `limit` faults.
    pub(crate) fn new(limit: usize) -> Self {
        Self {
            first: Vec::new(),
            count: 0,
            limit,
        }
    }

    /// Adds a fault.
    pub(crate) fn add(&mut self, fault: String) {
        self.count += 1;
        if self.first.len() < self.limit {
            self.first.push(fault);
        }
    }

    /// Returns the number of faults.
    pub(crate) fn count(&self) -> u64 {
        self.count
    }

    /// Returns the descriptions of the first faults.
    pub(crate) fn first(&self) -> &[String] {
        &self.first
    }

    /// Returns the descriptions of the first faults, and the number of further ones of a `kind`.
    pub(crate) fn summary(&self, kind: &str) -> Vec<String> {
        let more = self.count - self.first.len() as u64;
        let more = (more > 0).then(|| format!("and {more} more {kind}"));
        self.first.iter().cloned().chain(more).collect()
    }
}
