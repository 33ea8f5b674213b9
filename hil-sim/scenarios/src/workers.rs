//! Runs of a campaign beside each other.

use std::sync::Mutex;

use stm32f4_sim::shared::lock;

/// Does `work` on each item, `jobs` at a time; gives the results in the order of the items.
///
/// On threads of its own: the simulated phone works on the common pool of threads, and a
/// run that waited there for its phone would wait for ever.
pub(crate) fn each<T: Sync, R: Send>(
    items: &[T],
    jobs: usize,
    work: impl Fn(&T) -> R + Sync,
) -> Vec<R> {
    let waiting = Mutex::new(items.iter().enumerate());
    let next = || lock(&waiting).next();
    let worker = || {
        let mut done = Vec::new();
        while let Some((place, item)) = next() {
            done.push((place, work(item)));
        }
        done
    };
    let mut results: Vec<(usize, R)> = std::thread::scope(|scope| {
        let workers: Vec<_> = (0..jobs.max(1)).map(|_| scope.spawn(worker)).collect();
        let joined = workers.into_iter().map(|worker| match worker.join() {
            Ok(done) => done,
            Err(panic) => std::panic::resume_unwind(panic),
        });
        joined.flatten().collect()
    });
    results.sort_by_key(|(place, _)| *place);
    results.into_iter().map(|(_, result)| result).collect()
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    #[test]
    fn results_are_in_the_order_of_the_items_and_each_is_done_once() {
        let items: Vec<u64> = (0..20).collect();
        for jobs in [0, 1, 3, 40] {
            let doubled = super::each(&items, jobs, |&item| {
                std::thread::sleep(Duration::from_micros((item % 3) * 500));
                2 * item
            });
            assert!(
                doubled.iter().copied().eq((0..40).step_by(2)),
                "{doubled:?}"
            );
        }
    }
}
