"""The line of a thin beam, or a straight edge, as the marker: its normal displacement at stations along it."""
