"""Step 1: triples of segments that can be one line.

single_precision (what a pair predicts in the third view) -> index (who is there) -> search (who
passes the gate) -> triples: the value of `table`, in double precision, from all three orderings."""
