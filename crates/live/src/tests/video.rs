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
    // A caller that needs 250 ms per time step skips some. It shows the others, except the last, at
    // most 200 ms after they were due.
    let (mut now, mut shown, mut last) = (1000, 1, 10);
    loop {
        now += 250;
        match player.next(ms(now)) {
            Due::Time(time) => {
                assert!(time > last && (time == 99 || now - 100 * time as u64 <= 200), "{time} at {now} ms");
                (shown, last) = (shown + 1, time);
            }
            Due::Wait(_) => panic!("late times do not wait"),
            Due::End => break,
        }
    }
    assert_eq!((last, shown + 1 + player.dropped), (99, 100));
}

/// The caller is late for the whole rest of the video.
#[test]
fn the_last_time_is_shown_however_late_it_is() {
    for (count, late_ms, dropped) in [(1, 9000, 0), (2, 9000, 0), (8, 9000, 6), (8, u64::MAX / 2, 6)] {
        let mut player = Player::new(count, 10.0, 3);
        assert_eq!(player.next(ms(0)), Due::Time(0));
        if count > 1 {
            assert_eq!(player.next(ms(late_ms)), Due::Time(count - 1));
        }
        assert_eq!((player.next(ms(late_ms)), player.dropped), (Due::End, dropped), "{count}");
    }
    assert_eq!(Player::new(0, 10.0, 3).next(ms(0)), Due::End);
}

#[test]
fn a_player_that_may_be_late_without_limit_skips_nothing() {
    let mut player = Player::new(3, 10.0, usize::MAX);
    for (now, due) in [(0, Due::Time(0)), (9000, Due::Time(1)), (9000, Due::Time(2)), (9000, Due::End)] {
        assert_eq!((player.next(ms(now)), player.dropped), (due, 0));
    }
}

#[test]
fn a_rate_that_is_almost_zero_waits_instead_of_a_panic() {
    let mut player = Player::new(2, 1e-30, 3);
    assert_eq!(player.next(ms(5)), Due::Time(0));
    assert!(matches!(player.next(ms(5)), Due::Wait(time) if time > Duration::from_secs(1 << 40)));
}
