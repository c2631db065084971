"""Compare models of many records: on all cores of this machine, on Dask, or as a Slurm array.

    python examples/many_records.py records results                      # one record on each core
    python examples/many_records.py records results tcp://10.0.0.5:8786  # on a Dask scheduler
    sbatch --array=0-99 --cpus-per-task=1 --wrap \
        'python examples/many_records.py records results $SLURM_ARRAY_TASK_ID'
    splitband summary results/*                                          # one table of all of them

`records` contains CSV files whose input is called u. A third argument that is a number compares
one record, the one with this index. What is finished is left alone when the program runs again; in
a shell --skip-done does so:

    for f in records/*.csv; do
        splitband compare $f --inputs u --jobs 1 --skip-done --out results/$(basename $f .csv)
    done
"""

import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import splitband as sb


def compare(path: Path, out: Path) -> str:
    """Compare models of a record on one core, unless `out` has the result already."""
    if (out / "results.json").exists():
        return f"{path.name}: is there"
    record = sb.read(path, inputs=["u"])
    result = sb.compare(record, cores=1, rounds=1)
    if not result.interrupted:
        result.save(out)
    return f"{path.name}: {result.recommended}"


def main(records: str, results: str, where: str = "") -> None:
    """Compare all records, or one of them."""
    paths = sorted(Path(records).resolve().glob("*.csv"))
    outs = [Path(results).resolve() / path.stem for path in paths]
    if where.isdigit():
        print(compare(paths[int(where)], outs[int(where)]))
    elif where:
        from distributed import Client  # noqa: PLC0415  an extra

        with Client(where) as client:
            print(*client.gather(client.map(compare, paths, outs)), sep="\n")
    else:
        with ProcessPoolExecutor() as pool:
            print(*pool.map(compare, paths, outs), sep="\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
