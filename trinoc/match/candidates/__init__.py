"""Step 1: triples of segments that can be one line.

third_view (what a pair predicts there) -> index (who is there) -> search (who
passes the gate) -> triples: the value of `table`, from all three orderings."""
