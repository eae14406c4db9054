"""What a Dask cluster adds to a build through files, and that it writes the same files.

``python benchmarks/cluster.py [--chunks 3] [--part-rows 250000] [--folder /tmp]`` needs the shared city and the extra `dask`. The
cluster is two processes of this machine, of one thread and 1.5 GB each. An empty piece goes the way that pieces of a build go.
Processor seconds are those of the client, which holds the scheduler too, and of the workers.
"""

import argparse
import tempfile
import time
from pathlib import Path

import dask
from distributed import Client, LocalCluster

import splatree as st
from harness import DATA, save, table
from splatree.outofcore.cluster import cluster_at
from splatree.outofcore.work import Work

NUM_EMPTY = 500


def nothing(*job: object) -> None:
    """An empty piece."""


def cpu_s(client: Client) -> float:
    """Processor seconds of the client, the scheduler and the workers so far."""
    return time.process_time() + sum(client.run(time.process_time).values())


def files_in(folder: Path) -> dict[Path, bytes]:
    """All files of a folder."""
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--chunks", type=int, default=3, help="chunks of the city, at most 10")
    parser.add_argument("--part-rows", type=int, default=250_000)
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()))
    arguments = parser.parse_args()
    city = DATA / "trained" / "semarang_city"
    chunks = sorted(path for path in city.iterdir() if path.is_dir())[: arguments.chunks]
    settings = {"distributed.worker.profile.enabled": False}  # its thread takes a good part of a busy processor
    with (
        tempfile.TemporaryDirectory(dir=arguments.folder) as name,
        dask.config.set(settings),
        LocalCluster(n_workers=2, threads_per_worker=1, memory_limit="1.5GB", dashboard_address=":0") as cluster,
        Client(cluster.scheduler_address, set_as_default=False) as client,
    ):
        folder, address = Path(name), cluster.scheduler_address
        client.wait_for_workers(2)
        pids = client.run(lambda: __import__("os").getpid())
        work = Work(folder / "empty.work")
        work.begin()
        with cluster_at(address, work) as found:
            for count in (20, NUM_EMPTY):  # the first warms it up
                began, cpu = time.perf_counter(), cpu_s(client)
                for future in [
                    found.executor.submit(nothing, str(folder), "run", "grow", i, 3, 1) for i in range(count)
                ]:
                    future.result()
                empty_cpu, empty_wall = (cpu_s(client) - cpu) / count, (time.perf_counter() - began) / count

        ply = folder / "city.ply"
        num_rows = st.convert(chunks, ply).num_written
        began = time.process_time()
        st.build_folder(ply, folder / "here.splatree", running=st.FolderOptions(part_rows=arguments.part_rows))
        here = time.process_time() - began
        began = cpu_s(client)
        running = st.FolderOptions(part_rows=arguments.part_rows, scheduler=address)
        built = st.build_folder(ply, folder / "there.splatree", running=running)
        there = cpu_s(client) - began
        same = files_in(folder / "here.splatree") == files_in(folder / "there.splatree")
        num_pieces = 2 * built.num_parts
        rows = [
            {
                "Gaussians": num_rows,
                "pieces": num_pieces,
                "empty piece, CPU ms": 1e3 * empty_cpu,
                "empty piece, wall ms": 1e3 * empty_wall,
                "all pieces empty / build, CPU %": 100 * empty_cpu * num_pieces / there,
                "cluster / one process, CPU": there / here,
                "workers restarted": len(
                    set(client.run(lambda: __import__("os").getpid()).items()) - set(pids.items())
                ),
                "same files": "yes" if same else "no",
            }
        ]
        print(table(rows))
    save("cluster", rows, about="A build on a Dask cluster of two processes, beside a build in one")


if __name__ == "__main__":
    main()
