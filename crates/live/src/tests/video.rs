use std::time::Duration;

use crate::{Due, Player};

fn ms(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

#[test]
fn times_come_in_order_when_they_are_due() {
    let mut player = Player::new(3, 10.0, 2);
    assert_eq!(player.next(ms(500)), Due::Time(0));
    assert_eq!(player.next(ms(540)), Due::Wait(ms(60)));
    assert_eq!(player.next(ms(600)), Due::Time(1));
    // Time step 2 is 1.9 intervals late. It is shown, since this player allows two.
    assert_eq!(player.next(ms(890)), Due::Time(2));
    assert_eq!(player.next(ms(890)), Due::End);
    assert_eq!(player.dropped, 0);
}

#[test]
fn times_that_would_be_too_late_are_dropped_and_counted() {
    let mut player = Player::new(100, 10.0, 2);
    assert_eq!(player.next(ms(0)), Due::Time(0));
    // After a stall of the caller, time steps 1 to 9 are skipped, and time step 10 is due.
    assert_eq!(player.next(ms(1000)), Due::Time(10));
    assert_eq!(player.dropped, 9);
    // a caller that needs 250 ms per time step shows each one at most 200 ms after it was due
    let (mut now, mut shown, mut last) = (1000, 1, 10);
    loop {
        now += 250;
        match player.next(ms(now)) {
            Due::Time(time) => {
                assert!(time > last && now - 100 * time as u64 <= 200, "{time} at {now} ms");
                (shown, last) = (shown + 1, time);
            }
            Due::Wait(_) => panic!("late times do not wait"),
            Due::End => break,
        }
    }
    assert_eq!(shown + 1 + player.dropped, 100);
}
