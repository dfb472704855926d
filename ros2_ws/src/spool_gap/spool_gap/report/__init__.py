"""Result of an analysis: verdict, location of the gap, serialisation."""
