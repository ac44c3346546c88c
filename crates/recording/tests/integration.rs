//! Recordings from outside: written, damaged, recovered, and read by programs of others.

mod damage;
mod examples;
mod foreign;
mod recover;
mod round_trip;
