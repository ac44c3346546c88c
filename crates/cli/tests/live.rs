//! What the program does with devices, phones and browsers beside it: nearly all of the time of these tests is waiting, so that nothing
//! that computes for minutes may run beside them (that is in `commands`).

mod android;
mod capture_file;
mod chromium;
mod ctrl_c;
mod handbook;
mod inertial_units;
mod interrupted;
mod leaderboard;
mod mock;
mod pages;
mod process;
mod recorder;
mod running;
mod screen;
mod screen_faults;
mod screen_network;
mod session;
mod sidecar;
mod sidecar_page;
mod sidecar_rig;
mod simulated_session;
