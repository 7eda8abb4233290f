"""The governor: does it keep every limit whatever is commanded, and for all plants within the intervals it knows?"""
