//! Names of a model file and of effects as a person writes them.

/// `stribeck_friction` as a person writes it.
pub(super) fn spoken(name: &str) -> String {
    name.replace('_', " ")
}

/// `stribeck_force_n` as `stribeck force`: the unit stands beside the value. A name that is a unit is that of a
/// coefficient.
pub(super) fn without_unit(name: &str) -> String {
    const UNITS: [&str; 17] = [
        "_n_s2_m2",
        "_nm_s_rad",
        "_kg_m2",
        "_kg",
        "_nm_a",
        "_n_s_m",
        "_n_m3",
        "_n_m",
        "_rad_s",
        "_m_s",
        "_per_rev",
        "_rad",
        "_hz",
        "_n",
        "_m",
        "_s",
        "_a",
    ];
    let name = name.split_once('.').map_or_else(|| name.to_owned(), |(law, key)| format!("{law}_{key}"));
    if UNITS.iter().any(|u| u.strip_prefix('_') == Some(&name)) {
        return "coefficient".to_owned();
    }
    let bare = UNITS.iter().find_map(|u| name.strip_suffix(u)).filter(|b| !b.is_empty()).unwrap_or(&name);
    spoken(bare)
}
