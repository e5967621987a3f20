"""The file of a run: HDF5 that survives a kill at any moment and reads like documentation.

Layout (format `multiarm trajectory`, version 1)::

    /                        attributes: format, format_version, provenance (JSON)
    /scene                   the scene, YAML text
    /time, /object/..., /arms/<arm>/..., /energy/..., /drift/...
                             one resizable float64 dataset per channel, leading axis = samples,
                             attributes: unit, frame, description, columns
    /progress                [samples safely written, pieces of the outcome]
    /outcome                 status, message, statistics, events, certificate: JSON in pieces
    /amended, /amendment     entries of the outcome that were found out after the run, likewise

`writer` grows such a file, `reader` reads it channel by channel, `recovery` opens one that was
never closed, `amendment` says more about a run that is complete.
"""

from multiarm.results.storage.amendment import amend
from multiarm.results.storage.reader import TRAJECTORY, Hdf5Store
from multiarm.results.storage.writer import Hdf5Writer

writable_target = TRAJECTORY.writable_target

__all__ = ["Hdf5Store", "Hdf5Writer", "amend", "writable_target"]
