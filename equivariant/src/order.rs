//! The order of a group as a constant of the code that is compiled for it.

/// Evaluates an expression in which `$order` is a constant: the value of `$value`, 1, 2 or 4.
macro_rules! with_order {
    ($order:ident = $value:expr, $result:expr) => {
        match $value {
            1 => {
                const $order: usize = 1;
                $result
            }
            2 => {
                const $order: usize = 2;
                $result
            }
            _ => {
                const $order: usize = 4;
                $result
            }
        }
    };
}

pub(crate) use with_order;
