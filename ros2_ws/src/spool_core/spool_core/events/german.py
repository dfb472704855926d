"""German words and templates of an event's sentences."""

from __future__ import annotations

from spool_core.events.english import EventText, Language

EVENTS = {
    100: EventText(
        "Resonanz",
        "Die Maschine schüttelt das Ventil mit der Eigenfrequenz von Schieber und Federn.",
        "Drehzahl der Maschine ändern, Befestigung des Ventils dämpfen oder versetzen, oder die anderen "
        "Federn "
        "einbauen",
    ),
    200: EventText("Reibungsdrift"),
    201: EventText(
        "Reibungsdrift (Verschleiß)",
        "Der Spalt zwischen Schieber und Bohrung ist größer geworden: bei gleicher Temperatur bremst der "
        "Ölfilm weniger.",
        "innere Leckage messen, Reinheitsklasse des Öls prüfen, Tausch des Schiebers einplanen",
    ),
    202: EventText(
        "Reibungsdrift (Ölverschmutzung)",
        "Partikel oder Ölharz reiben im Spalt; die trockene Reibung steigt, und der Schieber beginnt zu "
        "klemmen.",
        "Ölprobe nehmen (ISO 4406), Filter wechseln, spülen, Schieber reinigen",
    ),
    203: EventText(
        "Reibungsdrift (Ölviskosität)",
        "Die Bremswirkung des Ölfilms hat sich stärker geändert, als seine Temperatur erklärt.",
        "Sorte und Alter des Öls, Wasser und Kraftstoff darin und das Thermometer prüfen",
    ),
    204: EventText(
        "Reibungsdrift (Ursache unbekannt)",
        "Die Reibung hat sich so geändert, wie es keine bekannte Ursache erklärt.",
        "mit der letzten Wartung vergleichen; war die Änderung gewollt, die Basislinie neu lernen",
    ),
    300: EventText("Federänderung"),
    301: EventText(
        "Federänderung (weicher)",
        "Eine Zentrierfeder hat Steifigkeit verloren, oder eine des Paares ist gebrochen.",
        "beide Federn ersetzen",
    ),
    302: EventText(
        "Federänderung (steifer)",
        "Den Schieber halten nicht nur seine Federn, oder andere Federn wurden eingebaut.",
        "prüfen, welche Federn eingebaut sind und ob eine auf Block liegt oder verschmutzt ist",
    ),
    400: EventText(
        "Schieber klemmt",
        "Die Maschine schüttelt, und der Schieber bewegt sich nicht im Gehäuse.",
        "Maschine sicher anhalten, Schieber mit der Handnotbetätigung bewegen, ausbauen und reinigen",
    ),
    500: EventText(
        "Modelllücke",
        "Eine Kraft wirkt, die das Modell nicht enthält.",
        "eine Minute davon aufzeichnen und mit ./spool gap bestimmen, was fehlt",
    ),
    600: EventText("Sensorfehler"),
    601: EventText(
        "Sensor ohne Signal",
        "Ein Kanal zeigt keine Schwingung, obwohl der andere eine zeigt, oder seine Werte ändern sich gar "
        "nicht.",
        "Kabel, Stecker und Versorgung der Beschleunigungssensoren prüfen, und ob die Messung läuft",
    ),
    602: EventText(
        "Sensor übersteuert",
        "Ein Kanal ist an seinem Endwert abgeschnitten.",
        "größeren Messbereich oder unempfindlicheren Beschleunigungssensor wählen",
    ),
    603: EventText(
        "Sensorversatz",
        "Der Mittelwert eines Kanals hat sich verschoben, was keine Schwingung bewirkt.",
        "Versorgung, Temperatur und Befestigung dieses Beschleunigungssensors prüfen",
    ),
    604: EventText(
        "Sensoren vertauscht",
        "Die Kanäle zeigen einen Schieber, der sein Gehäuse antreibt: Gehäuse und Schieber sind vertauscht, "
        "oder ein Sensor ist verdreht.",
        "Verdrahtung und Richtung beider Beschleunigungssensoren prüfen",
    ),
    605: EventText(
        "Sensorskalierung",
        "Das Verhältnis der Empfindlichkeiten beider Kanäle hat sich geändert.",
        "Befestigung und eingestellte Empfindlichkeit beider Beschleunigungssensoren prüfen, beide "
        "nebeneinander kalibrieren",
    ),
    606: EventText(
        "Gleicher Kanal",
        "Beide Kanäle tragen die Werte desselben Sensors.",
        "Verdrahtung prüfen, und welchen Kanal der Messung jedes Topic trägt",
    ),
    607: EventText(
        "Zahlenüberlauf",
        "Die ganzen Zahlen eines Kanals laufen über: jenseits des Bereichs springt er ans andere Ende.",
        "größeren Messbereich wählen, oder die Zahlen mit Breite und Vorzeichen des Wandlers lesen",
    ),
    608: EventText(
        "Falsche Empfindlichkeit",
        "Die Empfindlichkeit eines Kanals ist falsch: der Schieber folgt dem Gehäuse mit einem Faktor.",
        "Empfindlichkeit, Messbereich und Einheit beider Beschleunigungssensoren prüfen, beide nebeneinander "
        "kalibrieren",
    ),
    609: EventText(
        "AC-Kopplung",
        "Ein Kanal ist über einen Hochpass gekoppelt, der andere nicht; das verfälscht die Dämpfung.",
        "beide Kanäle auf DC-Kopplung oder auf die gleiche untere Grenze stellen",
    ),
    700: EventText(
        "Datenfehler", "Blöcke gingen verloren oder waren nicht verwendbar.", "Netz und Messrechner prüfen"
    ),
    701: EventText(
        "Falsche Abtastrate",
        "Die Abtastperiode widerspricht den Zeitstempeln; aus solchen Daten wird nichts geschätzt.",
        "die Abtastperiode korrigieren, die die Quelle sendet",
    ),
    702: EventText(
        "Zweite Quelle",
        "Zwei Quellen oder Schätzer senden, oder Blöcke oder Schätzungen nennen ein anderes Ventil; eine(r) "
        "wird verwendet.",
        "die zweite Quelle beenden oder ihr den Namensraum ihres eigenen Ventils geben",
    ),
    703: EventText(
        "Verlorene Blöcke",
        "Blöcke gingen unterwegs verloren, wie Sprünge der laufenden Nummer zeigen.",
        "Netz und Last des Messrechners prüfen",
    ),
    704: EventText(
        "Fehlerhafte Blöcke",
        "Blöcke hatten falsche Längen, Werte, Perioden oder Zeitstempel, oder eine Uhr wurde gestellt.",
        "Treiber der Messung prüfen, und die Uhr, von der seine Zeitstempel kommen",
    ),
    705: EventText(
        "Ausreißer",
        "Einzelne Werte sind unmöglich; sie werden ausgelassen, die anderen verwendet.",
        "Stecker und Kabel, Störungen, und was der Treiber ohne Messwert sendet, prüfen",
    ),
    706: EventText(
        "Wiederholte Werte",
        "Ein Kanal wiederholt seine Werte: der Sensor wird schneller abgefragt, als er misst.",
        "den Sensor mit seiner eigenen Rate abfragen, oder die Rate senden, mit der er misst",
    ),
    707: EventText(
        "Uhrensprung",
        "Die Uhr eines Sensors wurde gegen die des anderen verstellt; aus solchen Daten wird nichts "
        "geschätzt.",
        "die Uhren beider Sensoren synchronisieren, dann den Adapter neu starten",
    ),
    708: EventText(
        "Uhrendrift",
        "Die Uhr eines Sensors läuft schneller als die des anderen; Verzögerung und Dämpfung werden immer "
        "falscher.",
        "beide Sensoren mit einer Uhr abtasten, oder jedem eigene Zeitstempel geben",
    ),
    710: EventText(
        "Nicht beurteilt",
        "Blöcke kommen an, aber kein Detektor konnte das Ventil eine Minute lang beurteilen.",
        "die Ursache beseitigen, die in der Bemerkung steht; bis dahin ist nichts über das Ventil bekannt",
    ),
    800: EventText("Keine Daten", "Es kommen keine Daten an.", "prüfen, ob die Quelle läuft"),
    801: EventText("Keine Beschleunigung"),
    802: EventText("Keine Schätzwerte"),
    803: EventText(
        "Beschleunigung nie empfangen",
        "Es ist noch nie eine Beschleunigung angekommen.",
        "Name, Typ und Dienstgüte des Topics prüfen, und ob die Quelle läuft",
    ),
}

PARAMETERS = {
    "amplification": "Verstärkung",
    "viscous_coefficient": "viskose Dämpfung",
    "coulomb_force": "Coulomb-Kraft",
    "spring_stiffness": "Federsteifigkeit",
    "relative_motion": "Relativbewegung",
    "residual": "unerklärte Kraft",
    "channel_level": "Signalpegel",
    "flat_share": "flache Spitzen",
    "offset_change": "Änderung des Mittelwerts",
    "dissipation": "scheinbare Dämpfung",
    "gain_change": "Änderung der Verstärkung",
    "channel_difference": "Unterschied der Kanäle",
    "jump": "Sprung",
    "equal_samples": "gleiche Werte",
    "spool_over_body": "Schieber durch Gehäuse",
    "corner_frequency": "Eckfrequenz",
    "clock_step": "Uhrensprung",
    "clock_drift": "Uhrendrift",
    "period_departure": "Fehler der Periode",
    "faulty_blocks": "fehlerhafte Blöcke",
    "second_estimates": "Schätzungen eines anderen Schätzers",
    "lost_blocks": "verlorene Blöcke",
    "refused_blocks": "abgelehnte Blöcke",
    "outliers": "Ausreißer",
    "unjudged_time": "Zeit ohne Urteil",
    "silence": "Stille",
    "dominant_frequency": "Schüttelfrequenz",
    "natural_frequency": "Eigenfrequenz",
    "expected_amplification": "erwartete Verstärkung",
    "relative_displacement": "Weg des Schiebers im Gehäuse",
    "body_acceleration": "Beschleunigung des Gehäuses (effektiv)",
    "shown_acceleration": "gezeigte Beschleunigung (effektiv)",
    "expected_acceleration": "erwartete Beschleunigung (effektiv)",
    "unchanged_time": "Zeit ohne Änderung",
    "body_mean": "Mittelwert des Gehäuses",
    "spool_mean": "Mittelwert des Schiebers",
    "viscous_coefficient_change": "Änderung der viskosen Dämpfung",
    "coulomb_force_change": "Änderung der Coulomb-Kraft",
    "oil_temperature_change": "Änderung der Öltemperatur",
    "outlier": "unmöglicher Wert",
    "signal_span": "halbe Spanne des Signals",
    "body_outliers": "Ausreißer des Gehäuses",
    "spool_outliers": "Ausreißer des Schiebers",
}

WORDS = {
    "body": "Gehäuse",
    "spool": "Schieber",
    "both": "beide",
    "acceleration": "Beschleunigung",
    "estimate": "Schätzwert",
    "wear": "Verschleiß",
    "oil_contamination": "Ölverschmutzung",
    "oil_viscosity": "Ölviskosität",
    "unknown": "unbekannt",
    "softer": "weicher",
    "stiffer": "steifer",
    "none": "keine",
    "planned": "beim nächsten geplanten Halt",
    "soon": "bald",
    "immediate": "sofort",
    "alarm_passed": "bereits überschritten",
    "no_trend": "unbekannt: kein stetiger Verlauf",
    "at_rest": "die Maschine steht",
    "arrives_again": "es kommen wieder Daten an",
    "judged_again": "Detektoren beurteilen das Ventil wieder",
    "not_seen_any_more": "der Fehler ist nicht mehr zu sehen",
    "changes_again": "beide Beschleunigungssensoren ändern sich von Wert zu Wert",
    "oil_referred": "bei gleicher Öltemperatur verglichen",
    "oil_temperature_frozen": (
        "das Thermometer zeigt seit vor der Änderung dasselbe: steht es, sieht warmes Öl wie Verschleiß aus"
    ),
    "oil_temperature_unknown": "die Öltemperatur ist unbekannt: dünneres Öl kann wie Verschleiß aussehen",
    "seconds": "s",
    "minutes": "min",
    "hours": "h",
    "days": "Tage",
    "the data have gaps: no second without one": "die Daten haben Lücken: keine Sekunde ohne",
    "the valve's natural frequency is not known": "die Eigenfrequenz des Ventils ist unbekannt",
    "no detector has enough data": "kein Detektor hat genug Daten",
    "the stamps do not confirm the sample rate": "die Zeitstempel bestätigen die Abtastrate nicht",
    "the spool moves with its body": "der Schieber bewegt sich mit dem Gehäuse",
    "the relative motion gives energy away": "die Relativbewegung gibt Energie ab",
    "the ratio of the channels has changed": "das Verhältnis der Kanäle hat sich geändert",
    "body and spool differ in length or are empty": (
        "Gehäuse und Schieber haben verschiedene Längen oder sind leer"
    ),
    "the clock of one sensor was set: which samples of body and spool belong together is unknown": (
        "die Uhr eines Sensors wurde gestellt: welche Werte zusammengehören, ist unbekannt"
    ),
    "samples are NaN, infinite or beyond 1e6 m/s^2": "Werte sind NaN, unendlich oder über 1e6 m/s²",
    "stamp goes back": "der Zeitstempel geht zurück",
    "stamp is 0": "der Zeitstempel ist 0",
    "blocks lost (jump in sequence)": "Blöcke verloren (Sprung der laufenden Nummer)",
    "stamp is ahead by more than was lost": "der Zeitstempel ist weiter voraus, als verloren ging",
    "sequence goes back": "die laufende Nummer geht zurück",
    "sequence is ahead of what the stamps say elapsed": (
        "die laufende Nummer ist weiter, als die Zeitstempel vergangen sind"
    ),
    "stream goes on from another place (source restarted)": (
        "der Datenstrom setzt an anderer Stelle fort (Quelle neu gestartet)"
    ),
    "stream goes on at another time or rate (clock set)": (
        "der Datenstrom setzt mit anderer Zeit oder Rate fort (Uhr gestellt)"
    ),
    "sample_period changed": "sample_period hat sich geändert",
    "sample_period contradicts the stamps": "sample_period widerspricht den Zeitstempeln",
    "another stream: the source was restarted, or a second one sends": (
        "ein anderer Datenstrom: die Quelle wurde neu gestartet, oder eine zweite sendet"
    ),
    "a second estimator sends": "ein zweiter Schätzer sendet",
    "the estimates are of another valve from now on": "die Schätzungen gelten nun einem anderen Ventil",
    "a second source sends on the same topic": "eine zweite Quelle sendet auf demselben Topic",
}

LABELS = {
    "measured": "Gemessen",
    "baseline": "Gesundes Ventil",
    "change": "Änderung",
    "limit": "Grenze",
    "began": "Begann",
    "earlier": "{time} vor dieser Meldung",
    "lasted": "Dauerte",
    "causes": "Mögliche Ursachen",
    "evidence": "Weitere Zahlen",
    "note": "Bemerkung",
    "false_alarm_interval": "Erwarteter Abstand falscher Alarme",
    "urgency": "Dringlichkeit",
    "time_to_limit": "Zeit bis zur Alarmgrenze",
    "meaning": "Bedeutung",
    "advice": "Was zu tun ist",
    "interval": "{low} bis {high}, 95 %",
    "number": "Nummer {code}",
    "unknown": "unbekannt",
}

GERMAN = Language(
    code="de",
    decimal=",",
    raised="{title}: {parameter} {value}, Grenze {limit}",
    cleared="{title}, vorbei: {parameter} {value}, Grenze {limit}",
    events=EVENTS,
    parameters=PARAMETERS,
    words=WORDS,
    labels=LABELS,
)
