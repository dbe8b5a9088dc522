"""Speed measured on the machine at hand, against yardsticks that a faster or busier machine moves alike."""

from .run import PARTS, BenchSpec, run_bench

__all__ = ["PARTS", "BenchSpec", "run_bench"]
