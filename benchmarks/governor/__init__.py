"""The governor: does it keep every limit whatever is commanded, and what margin do muscles unlike their model need?"""
