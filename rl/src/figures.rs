//! The figures of an update: sums of them, and figures by name.

/// Declares sums, all `f64`, and how those of other steps or decisions are added to them.
macro_rules! sums {
    ($(#[$doc:meta])* $name:ident: $($sum:ident),+) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, Default, PartialEq)]
        pub(crate) struct $name {
            $(pub $sum: f64,)+
        }

        impl $name {
            /// Adds other sums.
            pub fn add(&mut self, other: &Self) {
                $(self.$sum += other.$sum;)+
            }
        }
    };
}

/// The fields of these names with their names, as [`Metrics`](crate::Metrics) returns them.
macro_rules! named {
    ($stats:ident: $($field:ident),+) => {
        vec![$((stringify!($field).to_owned(), $stats.$field as f64)),+]
    };
}

pub(crate) use {named, sums};
