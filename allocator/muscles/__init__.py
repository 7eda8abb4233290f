"""Published static models of pneumatic muscles, each named AuthorYear, and a catalogue of named parameter sets."""

from allocator.muscles.base import AffineMuscle, Muscle
from allocator.muscles.hogan import Hogan1984
from allocator.muscles.mckibben import TonduLopez1995
from allocator.muscles.sarosi import Sarosi2012
from allocator.muscles.tondu import Tondu2021

__all__ = ["AffineMuscle", "Hogan1984", "Muscle", "Sarosi2012", "Tondu2021", "TonduLopez1995"]
