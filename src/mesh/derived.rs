//! Tables that follow from a mesh alone, such as its search tree. The layers above define them; a mesh keeps each of
//! them from its first use on, so that later calls do not build it again.

use super::Mesh;
use std::any::{Any, TypeId};
use std::panic::resume_unwind;
use std::sync::OnceLock;

/// A table that follows from a mesh.
pub trait Derived: Any + Send + Sync {
    fn derive(mesh: &Mesh) -> Self;

    /// The table of `after`, which has the faces of `before` at moved vertices, made from this table of `before`. None
    /// if it must be derived anew.
    fn follow(&self, _before: &Mesh, _after: &Mesh) -> Option<Self>
    where
        Self: Sized,
    {
        None
    }

    /// Memory in use, bytes.
    fn bytes(&self) -> usize;
}

/// Largest number of different tables of one mesh.
const SLOTS: usize = 16;

/// The tables of a mesh, one slot for each type. The first type that finds a free slot keeps it.
#[derive(Debug, Default)]
pub(super) struct DerivedTables([OnceLock<TableSlot>; SLOTS]);

#[derive(Debug)]
struct TableSlot {
    id: TypeId,
    /// [`carry`] for the type of the slot.
    carry: fn(&AnyTable, &Mesh, &Mesh),
    value: OnceLock<Box<AnyTable>>,
    bytes: OnceLock<usize>,
}

type AnyTable = dyn Any + Send + Sync;

/// Passes a table of one mesh to another one with the same faces, if the type of the table can follow the motion.
fn carry<T: Derived>(table: &AnyTable, before: &Mesh, after: &Mesh) {
    let table: &T = table.downcast_ref().expect("a slot has the type that took it");
    if let Some(next) = table.follow(before, after) {
        after.tables.slot::<T>().fill(next);
    }
}

impl TableSlot {
    fn of<T: Derived>() -> Self {
        Self { id: TypeId::of::<T>(), carry: carry::<T>, value: OnceLock::new(), bytes: OnceLock::new() }
    }

    /// Stores a table. The first one that is stored stays.
    fn fill<T: Derived>(&self, table: T) -> &AnyTable {
        self.bytes.get_or_init(|| table.bytes());
        &**self.value.get_or_init(|| Box::new(table))
    }
}

impl DerivedTables {
    /// The slot of a type, taken at the first call.
    fn slot<T: Derived>(&self) -> &TableSlot {
        let id = TypeId::of::<T>();
        let slots = self.0.iter().map(|slot| slot.get_or_init(TableSlot::of::<T>));
        // Threads that come at the same time agree on the owner of a slot, so a type never has two.
        slots.into_iter().find(|slot| slot.id == id).expect("there is a slot for each type of table")
    }

    /// Passes the tables of `before`, which are these, to `after`, a mesh with the same faces.
    pub(super) fn carry(&self, before: &Mesh, after: &Mesh) {
        for slot in self.0.iter().filter_map(OnceLock::get) {
            if let Some(table) = slot.value.get() {
                (slot.carry)(&**table, before, after);
            }
        }
    }

    pub(super) fn bytes(&self) -> usize {
        self.0.iter().filter_map(|slot| slot.get()?.bytes.get()).sum()
    }
}

impl Mesh {
    /// A table of this mesh, built at the first call.
    pub fn derived<T: Derived>(&self) -> &T {
        let slot = self.tables.slot::<T>();
        let value = slot.value.get_or_init(|| {
            let table = T::derive(self);
            slot.bytes.get_or_init(|| table.bytes());
            Box::new(table)
        });
        value.downcast_ref().expect("a slot has the type that took it")
    }

    /// Whether a table has been built.
    pub fn has_derived<T: Derived>(&self) -> bool {
        let id = TypeId::of::<T>();
        self.tables.0.iter().filter_map(OnceLock::get).any(|slot| slot.id == id && slot.value.get().is_some())
    }
}

/// Runs a job on worker threads of its own, and waits for it without taking other jobs.
///
/// A worker thread that waits for a part of its job takes other jobs of its pool meanwhile. If such a job needs the
/// table that the thread is deriving, it waits forever. Tables that are first needed within a query are derived by this
/// function for that reason.
pub(crate) fn on_own_threads<T: Send>(job: impl FnOnce() -> T + Send) -> T {
    // Outside of a pool, asking for the number of threads would start the global pool.
    let threads = rayon::current_thread_index().map_or(1, |_| rayon::current_num_threads());
    let run = || match rayon::ThreadPoolBuilder::new().num_threads(threads).build() {
        Ok(pool) => pool.install(job),
        Err(_) => job(),
    };
    std::thread::scope(|scope| scope.spawn(run).join()).unwrap_or_else(|panic| resume_unwind(panic))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::random::soup;
    use rayon::prelude::*;
    use std::sync::atomic::{AtomicUsize, Ordering};

    static BUILT: AtomicUsize = AtomicUsize::new(0);

    struct Count<const N: usize>(usize);

    impl<const N: usize> Derived for Count<N> {
        fn derive(mesh: &Mesh) -> Self {
            BUILT.fetch_add(1, Ordering::Relaxed);
            // A table may need another one.
            Self(if N == 0 { mesh.faces().len() } else { mesh.derived::<Count<0>>().0 + N })
        }

        fn bytes(&self) -> usize {
            self.0
        }
    }

    #[test]
    fn tables_are_built_once_by_whichever_thread_comes_first() {
        let mesh = soup(12, 0.5, 3);
        assert!(!mesh.has_derived::<Count<0>>());
        let before = mesh.bytes();
        std::thread::scope(|scope| {
            for i in 0..8 {
                let mesh = &mesh;
                scope.spawn(move || {
                    assert_eq!(mesh.derived::<Count<0>>().0, 12);
                    assert_eq!(
                        if i % 2 == 0 { mesh.derived::<Count<1>>().0 } else { mesh.derived::<Count<2>>().0 - 1 },
                        13
                    );
                });
            }
        });
        assert_eq!(BUILT.load(Ordering::Relaxed), 3);
        assert!(mesh.has_derived::<Count<2>>());
        assert_eq!(mesh.bytes() - before, 12 + 13 + 14);
    }

    /// A sum that all worker threads compute.
    struct Sum(u32);

    impl Derived for Sum {
        fn derive(_: &Mesh) -> Self {
            Self(on_own_threads(|| {
                assert!(rayon::current_thread_index().is_some());
                (0..4000u32).into_par_iter().with_max_len(1).sum()
            }))
        }

        fn bytes(&self) -> usize {
            0
        }
    }

    #[test]
    fn tables_that_are_first_needed_by_worker_threads_do_not_block_them() {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(3).build().unwrap();
        for _ in 0..20 {
            let mesh = soup(12, 0.5, 3);
            let sum = |_| mesh.derived::<Sum>().0;
            let sums: Vec<u32> = pool.install(|| (0..300u32).into_par_iter().with_max_len(1).map(sum).collect());
            assert_eq!(sums, [3999 * 4000 / 2; 300]);
        }
        // Outside of a pool as well.
        assert_eq!(soup(12, 0.5, 3).derived::<Sum>().0, 3999 * 4000 / 2);
    }
}
