"""The dataset: a row is a grasp and its outcome, successes and failures alike, in Parquet shards."""

from .collect import CollectionSpec, collect
from .schema import SCHEMA_VERSION
from .shards import Dataset, load_dataset

__all__ = ["SCHEMA_VERSION", "CollectionSpec", "Dataset", "collect", "load_dataset"]
