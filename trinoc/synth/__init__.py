"""Truth: rigs, sheets and scenes, their pictures and segments, and scores against them."""
