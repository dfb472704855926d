"""Polish words and templates of an event's sentences."""

from __future__ import annotations

from spool_core.events.english import EventText, Language

EVENTS = {
    100: EventText(
        "Rezonans",
        "Maszyna wstrząsa zaworem z częstotliwością drgań własnych suwaka i sprężyn.",
        "zmienić prędkość maszyny, wytłumić lub przenieść mocowanie zaworu albo założyć inne sprężyny",
    ),
    200: EventText("Dryf tarcia"),
    201: EventText(
        "Dryf tarcia (zużycie)",
        "Szczelina między suwakiem a otworem wzrosła, więc film olejowy hamuje słabiej w tej samej "
        "temperaturze.",
        "zmierzyć przeciek wewnętrzny, sprawdzić klasę czystości oleju, zaplanować wymianę suwaka",
    ),
    202: EventText(
        "Dryf tarcia (zabrudzony olej)",
        "Cząstki lub osady trą w szczelinie; tarcie suche rośnie i suwak zaczyna się zacinać.",
        "pobrać próbkę oleju (ISO 4406), wymienić filtr, przepłukać, oczyścić suwak",
    ),
    203: EventText(
        "Dryf tarcia (lepkość oleju)",
        "Opór filmu olejowego zmienił się bardziej, niż wyjaśnia to jego temperatura.",
        "sprawdzić gatunek i wiek oleju, wodę i paliwo w oleju oraz termometr",
    ),
    204: EventText(
        "Dryf tarcia (przyczyna nieznana)",
        "Tarcie zmieniło się w sposób, którego nie wyjaśnia żadna znana przyczyna.",
        "porównać z ostatnią konserwacją; jeśli zmiana była zamierzona, nauczyć nową linię bazową",
    ),
    300: EventText("Zmiana sprężyny"),
    301: EventText(
        "Zmiana sprężyny (miększa)",
        "Sprężyna centrująca straciła sztywność albo jedna z pary pękła.",
        "wymienić obie sprężyny",
    ),
    302: EventText(
        "Zmiana sprężyny (sztywniejsza)",
        "Suwak trzymają nie tylko sprężyny albo założono inne sprężyny.",
        "sprawdzić, jakie sprężyny są założone i czy któraś nie jest zablokowana lub zabrudzona",
    ),
    400: EventText(
        "Suwak zakleszczony",
        "Maszyna wstrząsa, a suwak nie porusza się w korpusie.",
        "bezpiecznie zatrzymać maszynę, poruszyć suwak ręcznym przyciskiem awaryjnym, wymontować i oczyścić",
    ),
    500: EventText(
        "Luka modelu",
        "Działa siła, której model nie zawiera.",
        "nagrać minutę pracy i poleceniem ./spool gap ustalić, czego brakuje",
    ),
    600: EventText("Usterka czujnika"),
    601: EventText(
        "Czujnik bez sygnału",
        "Kanał nie pokazuje drgań, choć drugi je pokazuje, albo jego próbki w ogóle się nie zmieniają.",
        "sprawdzić kabel, wtyk i zasilanie akcelerometrów oraz czy pomiar działa",
    ),
    602: EventText(
        "Czujnik przesterowany",
        "Kanał jest obcięty na końcu zakresu.",
        "wybrać większy zakres lub mniej czuły akcelerometr",
    ),
    603: EventText(
        "Przesunięcie czujnika",
        "Średnia kanału przesunęła się, czego drgania nie powodują.",
        "sprawdzić zasilanie, temperaturę i mocowanie tego akcelerometru",
    ),
    604: EventText(
        "Czujniki zamienione",
        "Kanały pokazują suwak, który napędza korpus: korpus i suwak są zamienione albo czujnik jest "
        "odwrócony.",
        "sprawdzić okablowanie i kierunek obu akcelerometrów",
    ),
    605: EventText(
        "Skala czujnika",
        "Stosunek czułości kanałów zmienił się.",
        "sprawdzić mocowanie i ustawioną czułość obu akcelerometrów, skalibrować je obok siebie",
    ),
    606: EventText(
        "Ten sam kanał",
        "Oba kanały niosą odczyty jednego czujnika.",
        "sprawdzić okablowanie oraz który kanał pomiaru niesie każdy temat",
    ),
    607: EventText(
        "Przepełnienie zakresu",
        "Liczby całkowite kanału przepełniają się: poza zakresem kanał przeskakuje na drugi koniec.",
        "wybrać większy zakres albo czytać liczby z szerokością i znakiem przetwornika",
    ),
    608: EventText(
        "Błędna czułość",
        "Czułość jednego kanału jest błędna: suwak podąża za korpusem ze współczynnikiem.",
        "sprawdzić czułość, zakres i jednostkę obu akcelerometrów, skalibrować je obok siebie",
    ),
    609: EventText(
        "Sprzężenie AC",
        "Jeden kanał jest sprzężony przez filtr górnoprzepustowy, drugi nie; to zniekształca tłumienie.",
        "ustawić oba kanały na sprzężenie DC albo na tę samą dolną granicę",
    ),
    700: EventText(
        "Błąd danych", "Bloki zginęły lub nie nadawały się do użycia.", "sprawdzić sieć i komputer pomiarowy"
    ),
    701: EventText(
        "Błędne próbkowanie",
        "Okres próbkowania przeczy znacznikom czasu; z takich danych nic nie jest szacowane.",
        "poprawić okres próbkowania, który wysyła źródło",
    ),
    702: EventText(
        "Drugie źródło",
        "Wysyłają dwa źródła lub estymatory albo bloki lub estymaty podają inny zawór; używane jest jedno.",
        "zakończyć drugie źródło albo dać mu przestrzeń nazw jego własnego zaworu",
    ),
    703: EventText(
        "Zgubione bloki",
        "Bloki zginęły po drodze, co pokazują skoki numeru kolejnego.",
        "sprawdzić sieć i obciążenie komputera pomiarowego",
    ),
    704: EventText(
        "Wadliwe bloki",
        "Bloki miały błędną długość, próbki, okres lub znaczniki czasu albo przestawiono zegar.",
        "sprawdzić sterownik pomiaru i zegar, z którego pochodzą jego znaczniki",
    ),
    705: EventText(
        "Wartości odstające",
        "Pojedyncze próbki są niemożliwe; są pomijane, pozostałe są używane.",
        "sprawdzić wtyki i kable, zakłócenia oraz co sterownik wysyła przy braku odczytu",
    ),
    706: EventText(
        "Powtórzone próbki",
        "Kanał powtarza próbki: czujnik jest odpytywany szybciej, niż mierzy.",
        "odpytywać czujnik z jego częstotliwością albo wysyłać częstotliwość, z którą mierzy",
    ),
    707: EventText(
        "Skok zegara",
        "Zegar jednego czujnika przestawiono względem drugiego; z takich danych nic nie jest szacowane.",
        "zsynchronizować zegary obu czujników, potem ponownie uruchomić adapter",
    ),
    708: EventText(
        "Dryf zegara",
        "Zegar jednego czujnika chodzi szybciej niż drugiego; opóźnienie i tłumienie są coraz bardziej "
        "błędne.",
        "próbkować oba czujniki jednym zegarem albo nadać każdemu własne znaczniki czasu",
    ),
    710: EventText(
        "Brak oceny",
        "Bloki docierają, ale przez minutę żaden detektor nie mógł ocenić zaworu.",
        "usunąć przyczynę podaną w uwadze; do tego czasu stan zaworu jest nieznany",
    ),
    800: EventText("Brak danych", "Dane nie docierają.", "sprawdzić, czy źródło działa"),
    801: EventText("Brak przyspieszeń"),
    802: EventText("Brak oszacowań"),
    803: EventText(
        "Przyspieszenia nigdy nie odebrano",
        "Żadne przyspieszenie jeszcze nie dotarło.",
        "sprawdzić nazwę, typ i jakość usługi tematu oraz czy źródło działa",
    ),
}

PARAMETERS = {
    "amplification": "wzmocnienie",
    "viscous_coefficient": "tłumienie lepkie",
    "coulomb_force": "siła Coulomba",
    "spring_stiffness": "sztywność sprężyn",
    "relative_motion": "ruch względny",
    "residual": "siła niewyjaśniona",
    "channel_level": "poziom sygnału",
    "flat_share": "płaskie szczyty",
    "offset_change": "zmiana średniej",
    "dissipation": "pozorne tłumienie",
    "gain_change": "zmiana wzmocnienia",
    "channel_difference": "różnica kanałów",
    "jump": "przeskok",
    "equal_samples": "równe próbki",
    "spool_over_body": "suwak do korpusu",
    "corner_frequency": "częstotliwość graniczna",
    "clock_step": "skok zegara",
    "clock_drift": "dryf zegara",
    "period_departure": "błąd okresu",
    "faulty_blocks": "wadliwe bloki",
    "second_estimates": "estymaty innego estymatora",
    "lost_blocks": "zgubione bloki",
    "refused_blocks": "odrzucone bloki",
    "outliers": "wartości odstające",
    "unjudged_time": "czas bez oceny",
    "silence": "cisza",
    "dominant_frequency": "częstotliwość wstrząsów",
    "natural_frequency": "częstotliwość własna",
    "expected_amplification": "oczekiwane wzmocnienie",
    "relative_displacement": "ruch suwaka w korpusie",
    "body_acceleration": "przyspieszenie korpusu (skuteczne)",
    "shown_acceleration": "wskazane przyspieszenie (skuteczne)",
    "expected_acceleration": "oczekiwane przyspieszenie (skuteczne)",
    "unchanged_time": "czas bez zmiany",
    "body_mean": "średnia korpusu",
    "spool_mean": "średnia suwaka",
    "viscous_coefficient_change": "zmiana tłumienia lepkiego",
    "coulomb_force_change": "zmiana siły Coulomba",
    "oil_temperature_change": "zmiana temperatury oleju",
    "outlier": "niemożliwa próbka",
    "signal_span": "połowa rozpiętości sygnału",
    "body_outliers": "odstające próbki korpusu",
    "spool_outliers": "odstające próbki suwaka",
}

WORDS = {
    "body": "korpus",
    "spool": "suwak",
    "both": "oba",
    "acceleration": "przyspieszenie",
    "estimate": "oszacowanie",
    "wear": "zużycie",
    "oil_contamination": "zabrudzenie oleju",
    "oil_viscosity": "lepkość oleju",
    "unknown": "nieznana",
    "softer": "miększa",
    "stiffer": "sztywniejsza",
    "none": "brak",
    "planned": "przy następnym planowym postoju",
    "soon": "wkrótce",
    "immediate": "natychmiast",
    "alarm_passed": "już przekroczona",
    "no_trend": "nieznany: brak stałego trendu",
    "at_rest": "maszyna stoi",
    "arrives_again": "dane znów docierają",
    "judged_again": "detektory znów oceniają zawór",
    "not_seen_any_more": "usterki już nie widać",
    "changes_again": "oba akcelerometry zmieniają się z próbki na próbkę",
    "oil_referred": "porównano w tej samej temperaturze oleju",
    "oil_temperature_frozen": (
        "termometr pokazuje to samo od chwili przed zmianą: jeśli stoi, ciepły olej wygląda jak zużycie"
    ),
    "oil_temperature_unknown": "temperatura oleju jest nieznana: rzadszy olej może wyglądać jak zużycie",
    "seconds": "s",
    "minutes": "min",
    "hours": "h",
    "days": "dni",
    "the data have gaps: no second without one": "dane mają luki: ani sekundy bez luki",
    "the valve's natural frequency is not known": "częstotliwość własna zaworu jest nieznana",
    "no detector has enough data": "żaden detektor nie ma dość danych",
    "the stamps do not confirm the sample rate": (
        "znaczniki czasu nie potwierdzają częstotliwości próbkowania"
    ),
    "the spool moves with its body": "suwak porusza się razem z korpusem",
    "the relative motion gives energy away": "ruch względny oddaje energię",
    "the ratio of the channels has changed": "stosunek kanałów zmienił się",
    "body and spool differ in length or are empty": "korpus i suwak mają różne długości lub są puste",
    "the clock of one sensor was set: which samples of body and spool belong together is unknown": (
        "przestawiono zegar jednego czujnika: nie wiadomo, które próbki należą do siebie"
    ),
    "samples are NaN, infinite or beyond 1e6 m/s^2": "próbki są NaN, nieskończone lub powyżej 1e6 m/s²",
    "stamp goes back": "znacznik czasu cofa się",
    "stamp is 0": "znacznik czasu jest równy 0",
    "blocks lost (jump in sequence)": "zgubione bloki (skok numeru kolejnego)",
    "stamp is ahead by more than was lost": "znacznik czasu wyprzedza o więcej, niż zgubiono",
    "sequence goes back": "numer kolejny cofa się",
    "sequence is ahead of what the stamps say elapsed": (
        "numer kolejny wyprzedza czas, który minął według znaczników"
    ),
    "stream goes on from another place (source restarted)": (
        "strumień biegnie dalej od innego miejsca (źródło uruchomiono ponownie)"
    ),
    "stream goes on at another time or rate (clock set)": (
        "strumień biegnie dalej w innym czasie lub z inną częstotliwością (przestawiono zegar)"
    ),
    "sample_period changed": "sample_period zmienił się",
    "sample_period contradicts the stamps": "sample_period przeczy znacznikom czasu",
    "another stream: the source was restarted, or a second one sends": (
        "inny strumień: źródło uruchomiono ponownie albo wysyła drugie"
    ),
    "a second estimator sends": "drugi estymator wysyła",
    "the estimates are of another valve from now on": "estymaty dotyczą odtąd innego zaworu",
    "a second source sends on the same topic": "drugie źródło wysyła na ten sam temat",
}

LABELS = {
    "measured": "Zmierzono",
    "baseline": "Zdrowy zawór",
    "change": "Zmiana",
    "limit": "Granica",
    "began": "Początek",
    "earlier": "{time} przed tym komunikatem",
    "lasted": "Czas trwania",
    "causes": "Możliwe przyczyny",
    "evidence": "Dalsze liczby",
    "note": "Uwaga",
    "false_alarm_interval": "Oczekiwany odstęp fałszywych alarmów",
    "urgency": "Pilność",
    "time_to_limit": "Czas do granicy alarmu",
    "meaning": "Znaczenie",
    "advice": "Co zrobić",
    "interval": "{low} do {high}, 95 %",
    "number": "numer {code}",
    "unknown": "nieznane",
}

POLISH = Language(
    code="pl",
    decimal=",",
    raised="{title}: {parameter} {value}, granica {limit}",
    cleared="{title}, koniec: {parameter} {value}, granica {limit}",
    events=EVENTS,
    parameters=PARAMETERS,
    words=WORDS,
    labels=LABELS,
)
