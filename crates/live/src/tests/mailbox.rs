use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use crate::Mailbox;

#[test]
fn readers_get_the_newest_value_once() {
    let mailbox = Mailbox::default();
    assert!(mailbox.after(0).is_none());
    assert_eq!([mailbox.post('a'), mailbox.post('b')], [1, 2]);
    let (seen, value) = mailbox.after(0).unwrap();
    assert_eq!((seen, *value), (2, 'b'));
    assert!(mailbox.after(seen).is_none() && mailbox.wait_after(seen, Duration::from_millis(1)).is_none());
    // a reader whose last value is number 1 gets the newest value, too
    assert_eq!(*mailbox.after(1).unwrap().1, 'b');
}

#[test]
fn values_that_nobody_takes_do_not_pile_up() {
    let (mailbox, counted) = (Mailbox::default(), std::sync::Arc::new(()));
    for _ in 0..1000 {
        mailbox.post(counted.clone());
    }
    assert_eq!(std::sync::Arc::strong_count(&counted), 2);
}

/// A solver stalls for 2 s. Meanwhile a display reads about 200 times a second. The display
/// receives complete values with rising numbers.
#[test]
fn a_display_never_waits_for_a_solver() {
    const REFRESH: Duration = Duration::from_millis(5);
    let (mailbox, stop) = (Mailbox::default(), AtomicBool::new(false));
    let solve = |number: u64| vec![number; 10_000];
    std::thread::scope(|scope| {
        scope.spawn(|| {
            for number in 1..=200 {
                mailbox.post(solve(number));
            }
            std::thread::sleep(Duration::from_secs(2));
            for number in 201..=400 {
                mailbox.post(solve(number));
            }
            stop.store(true, Ordering::SeqCst);
        });
        let (mut seen, mut last, mut looks, mut longest) = (0, 0, 0u32, Duration::ZERO);
        while !stop.load(Ordering::SeqCst) {
            let start = Instant::now();
            if let Some((number, value)) = mailbox.after(seen) {
                assert!(number > seen && value[0] > last && value.iter().all(|part| *part == value[0]));
                (seen, last) = (number, value[0]);
            }
            longest = longest.max(start.elapsed());
            looks += 1;
            std::thread::sleep(REFRESH);
        }
        // a busy machine delays the sleeps, but no read may last as long as 20 refreshes
        assert!(looks > 100 && longest < 20 * REFRESH, "{looks} reads, the longest {longest:?}");
        assert_eq!(mailbox.after(0).unwrap().0, 400);
    });
}
