//! How a session goes on after the link was lost or the board was reset.
//!
//! A lost link is waited for, and the session goes on with it, or ends ([`relink`]).
//! Nothing is lost by that but the messages meanwhile, which show by their numbers.
//!
//! A board that was reset while recording begins a new run ([`restart`]):
//!
//! 1. As soon as the board answers again, its clock and this computer's are read
//!    beside each other: the new run's place on the recording's axis
//!    ([`timebase::runs`]).
//! 2. Before the first message of the new run is recorded, a mark is
//!    (`/session/board_run`), and the run is in the session file.
//! 3. The IMU is set up as the profile wants it, the trigger is started on the
//!    grid that it was on, the further outputs join it.
//!
//! The phase against the phone's frames then is as good as the shift of the axis is
//! known (`Joint::sigma_s`), not as good as a twist makes it; the relation of
//! each phone and the board is recorded anew with that uncertainty, and so is where
//! the frames of further phones lie against the depth images. A second twist at the
//! end belongs to the last run.
//!
//! A reset before the recording ends the session: what was found out about the board's
//! clock is void.

mod relink;
pub(super) mod restart;
